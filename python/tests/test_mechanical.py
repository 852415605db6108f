"""Mechanical systems whose functions are ordinary Python."""

import json
import math
import pickle
import re
from math import cos, sin

import numpy as np
import pytest
from conftest import SOURCE
from numpy.testing import assert_allclose

import saltus

# Exact values: closed forms, and Taylor series with 60 digits, differentiated by variational equations.
REFERENCES = json.loads((SOURCE / "data" / "mechanical_references.json").read_text(encoding="utf-8"))


def numbers(values):
    return np.array([float(value) for value in values])


def pendulum():
    def force(q, p):
        m, l, g, *_ = p
        return [-m * g * l * sin(q[0])]

    return saltus.MechanicalSystem(
        coordinates=["th"], parameters=["m", "l", "g", "a", "b", "e"],
        mass=lambda q, p: [[p[0] * p[1] ** 2]], force=force,
        contacts={"right": saltus.Contact(gap=lambda q, p: p[3] - p[1] * sin(q[0]), restitution="e"),
                  "left": saltus.Contact(gap=lambda q, p: p[4] + p[1] * sin(q[0]), restitution=lambda p: p[5])})


def cart_pole():
    def mass(q, p):
        k = p[1] * p[2] * cos(q[1]) / 2
        return np.array([[p[0] + p[1], k], [k, p[1] * p[2] ** 2 / 3]])

    def force(t, q, v, u, p):
        M, m, l, g, c, *_ = p
        return [u[0] + m * l * sin(q[1]) * v[1] ** 2 / 2 - c * v[0], m * g * l * sin(q[1]) / 2]

    def tip(q, p):
        return q[0] + p[2] * np.sin(q[1])

    return saltus.MechanicalSystem(
        coordinates=["x", "th"], controls=["u1"], parameters=["M", "m", "l", "g", "c", "w", "s", "et", "ec"],
        mass=mass, force=force,
        contacts={"tip_right": saltus.Contact(gap=lambda q, p: p[5] - tip(q, p), restitution="et"),
                  "tip_left": saltus.Contact(gap=lambda q, p: p[5] + tip(q, p), restitution="et"),
                  "cart_right": saltus.Contact(gap=lambda q, p: p[6] - q[0], restitution="ec"),
                  "cart_left": saltus.Contact(gap=lambda q, p: p[6] + q[0], restitution="ec")})


def double_pendulum(with_row=False):
    def mass(q, p):
        m1, m2, l1, l2, *_ = p
        k = m2 * l1 * l2 * cos(q[0] - q[1]) / 2
        return [[(m1 / 3 + m2) * l1**2, k], [k, m2 * l2**2 / 3]]

    def force(q, v, p):
        m1, m2, l1, l2, g, *_ = p
        s = m2 * l1 * l2 * sin(q[0] - q[1]) / 2
        return [-s * v[1] ** 2 - (m1 / 2 + m2) * g * l1 * sin(q[0]), s * v[0] ** 2 - m2 * g * l2 * sin(q[1]) / 2]

    def tip(q, p):
        return np.array([p[2] * sin(q[0]) + p[3] * sin(q[1]), p[5] - p[2] * cos(q[0]) - p[3] * cos(q[1])])

    def row(q, p):
        along = [[p[2] * cos(q[0]), p[3] * cos(q[1])], [p[2] * sin(q[0]), p[3] * sin(q[1])]]
        return [cos(p[6]) * along[0][i] + sin(p[6]) * along[1][i] for i in range(2)]

    slide = {"slide_row": row} if with_row else {"slide": lambda q, p: np.array([cos(p[6]), sin(p[6])]) @ tip(q, p)}
    return saltus.MechanicalSystem(
        coordinates=["th1", "th2"], parameters=["m1", "m2", "l1", "l2", "g", "d", "al", "e", "mu"], mass=mass, force=force,
        contacts={"tip": saltus.Contact(gap=lambda q, p: np.array([-sin(p[6]), cos(p[6])]) @ tip(q, p),
                                        restitution="e", friction="mu", **slide)})


def box():
    signs = {"A": (-1, -1), "B": (1, -1), "C": (1, 1), "D": (-1, 1)}

    def corner(along, across):
        return saltus.Contact(
            gap=lambda q, p: q[1] + along * p[1] * sin(q[2]) + across * p[2] * cos(q[2]),
            slide=lambda q, p: q[0] + along * p[1] * cos(q[2]) - across * p[2] * sin(q[2]), restitution="e", friction="mu")

    return saltus.MechanicalSystem(
        coordinates=["x", "y", "th"], parameters=["m", "a", "b", "g", "e", "mu"],
        mass=lambda p: np.diag([p[0], p[0], p[0] * (p[1] ** 2 + p[2] ** 2) / 3]),
        force=lambda p: [0, -p[0] * p[3], 0], contacts={name: corner(*sign) for name, sign in signs.items()})


SYSTEMS = {"P1": pendulum, "P2": cart_pole, "P3": double_pendulum, "P4": box}


def reference_problem(name, system=None, **options):
    data = REFERENCES[name]["data"]
    system = system or SYSTEMS[name[:2]]()
    control = numbers(data["u"])[:, None] if "u" in data else None
    return saltus.HybridProblem(
        system, initial=numbers(data["q0"] + data["v0"]), duration=float(data["T"]), control=control,
        parameters=[float(data["parameters"][p]) for p in system.parameters], tolerance=1e-14, **options)


def by(derivatives, prefix, name, problem):
    """The derivatives by a quantity of the file: q1, v2, u1_7, T or a parameter."""
    n = len(problem.system.coordinates)
    if name == "T":
        return derivatives[prefix + "duration"]
    if name in problem.system.parameters:
        return derivatives[prefix + "parameters"][:, problem.system.parameters.index(name)]
    if name[0] == "u":
        return derivatives[prefix + "control"][:, int(name.split("_")[1]), 0]
    return derivatives[prefix + "initial"][:, int(name[1:]) - 1 + (n if name[0] == "v" else 0)]


EVENTS = {"hit": "hit", "off": "off", "vt0": "stop", "slip+": "break+", "slip-": "break-"}


@pytest.mark.parametrize("name", ["P1", "P2", "P3a", "P3b", "P3c", "P3z", "P4", "P4r"])
def test_motion_and_derivatives_are_the_exact_ones(name):
    """Also stick and slip, detachment, and bounces that accumulate (P3z)."""
    reference, problem = REFERENCES[name], reference_problem(name)
    precise = 1e-10 if name != "P3z" else 1e-8
    motion, derivatives = saltus.rollout(problem), saltus.final_derivatives(problem)
    expected = numbers(reference["state_at_T"])
    assert_allclose(motion.final, expected, rtol=0, atol=precise * max(np.abs(expected).max(), 1e-3))
    assert motion.mode == reference["modes_last"]
    table = {key: numbers(row) for key, row in reference["derivatives"].items()}
    table["T"] = numbers(reference.get("dx_dT_intervals_stretch", reference["dx_dT"]))
    largest = np.maximum(np.abs(list(table.values())).max(axis=0), 1e-3)
    for key, row in table.items():
        assert_allclose(by(derivatives, "by_", key, problem) / largest, row / largest, rtol=0, atol=1e-8, err_msg=key)
    accumulated = [event["kind"] == "accumulated" for event in reference["events"]]
    compared = reference["events"][: accumulated.index(True)] if any(accumulated) else reference["events"]
    if not any(accumulated):
        assert len(motion.events) == len(compared)
    for number, event in enumerate(compared):
        time, _, guard, next_mode = motion.events[number]
        assert guard == f"{EVENTS[event['kind']]} {event['contact']}"
        assert next_mode == event["mode"]
        assert abs(time - float(event["t"])) < precise * problem.duration
        size = max([1e-3, *(abs(float(value)) for value in event["dt"].values())])
        for key, value in event["dt"].items():
            assert abs(by(derivatives, "times_by_", key, problem)[number] - float(value)) < 1e-8 * size, key


def test_a_row_in_the_place_of_a_tangential_coordinate_gives_the_same_motion():
    reference, problem = REFERENCES["P3b"], reference_problem("P3b", double_pendulum(with_row=True))
    assert_allclose(saltus.rollout(problem).final, numbers(reference["state_at_T"]), rtol=1e-10)


@pytest.mark.parametrize("case", ["P8_slip", "P8_stick", "P8_back"])
def test_an_impact_with_friction_is_the_closed_form(case):
    """A vertex hits the ground at once; the velocity after it, and its derivatives."""
    form = REFERENCES["closed_forms"][case]
    m, inertia, rx, ry, vx, vy, w, e, mu = numbers(form["data"])
    system = saltus.MechanicalSystem(
        coordinates=["x", "y", "th"], parameters=["m", "I", "rx", "ry", "e", "mu"],
        mass=lambda p: np.diag([p[0], p[0], p[1]]), force=lambda q: [0, 0, 0],
        contacts={"vertex": saltus.Contact(
            gap=lambda q, p: q[1] + p[2] * sin(q[2]) + p[3] * cos(q[2]),
            slide=lambda q, p: q[0] + p[2] * cos(q[2]) - p[3] * sin(q[2]), restitution="e", friction="mu")})
    problem = saltus.HybridProblem(system, initial=[0, -ry, 0, vx, vy, w], parameters=[m, inertia, rx, ry, e, mu],
                                   duration=0.05)
    motion, derivatives = saltus.rollout(problem), saltus.final_derivatives(problem)
    assert [event[2] for event in motion.events] == ["hit vertex"]
    assert_allclose(motion.final[3:], numbers(form["v"]), rtol=1e-12)
    for key, row in form["grad"].items():
        if key in ("rx", "ry"):  # the start stays on the ground as the vertex moves
            continue
        column = {"vx": 3, "vy": 4, "w": 5}.get(key)
        found = (derivatives.by_initial[3:, column] if column is not None
                 else derivatives.by_parameters[3:, system.parameters.index(key)])
        assert_allclose(found, numbers(row), rtol=1e-9, atol=1e-9, err_msg=key)


def poisson_and_newton(law):
    """A rod at 45 degrees without gravity or rotation before it hits, whose laws differ where friction changes v_n."""
    return saltus.MechanicalSystem(
        coordinates=["x", "y", "th"], impact_law=law, mass=lambda q: np.diag([1.0, 1.0, 0.2]), force=lambda q: [0.0, 0.0, 0.0],
        contacts={"end": saltus.Contact(gap=lambda q: q[1] - 0.5 * sin(q[2]), slide=lambda q: q[0] - 0.5 * cos(q[2]),
                                        restitution=0.7, friction=0.3)})


def test_impact_laws_are_those_of_closed_forms():
    """Newton: v_n+ = -e v_n. Poisson: the impulse of expansion is e times that of compression."""
    th = 0.5
    normal, tangent = np.array([0, 1, -0.5 * cos(th)]), np.array([1, 0, 0.5 * sin(th)])
    v = np.array([2.0, -1.0, 0.0])
    inverse = np.diag([1, 1, 1 / 0.2])
    force = normal - 0.3 * tangent  # it slides with v_t > 0 throughout
    effect = normal @ inverse @ force
    for law in ("newton", "poisson"):  # of a contact that slides on, both laws have the impulse (1 + e) |v_n| / effect
        problem = saltus.HybridProblem(poisson_and_newton(law), initial=[0, 0.5 * sin(th), th, *v], duration=0.01)
        expected = v + inverse @ force * 1.7 / effect
        assert tangent @ expected > 0
        assert_allclose(saltus.rollout(problem).final[3:], expected, rtol=1e-12)


def swing_up(force, **keywords):
    """P12: a pendulum of 1 kg and 1 m that may use an elastic wall at 30 degrees."""
    return saltus.MechanicalSystem(
        coordinates=["th"], mass=lambda q: [[1.0]], force=force,
        contacts={"wall": saltus.Contact(gap=lambda q: 0.5 - sin(q[0]), restitution=0.9)}, **keywords)


def test_a_pendulum_that_strikes_a_wall_where_its_control_switches():
    pinned = REFERENCES["P12"]["pinned"]
    system = swing_up(lambda q, u: [u[0] - 9.81 * sin(q[0])], controls=["torque"])
    problem = saltus.HybridProblem(
        system, initial=[0, 0], duration=1.6, control=numbers(pinned["u"])[:, None], tolerance=1e-14,
        costs=[saltus.terminal([-math.pi, 0], weight=[100, 10]), saltus.effort(0.02)])
    run = saltus.solve(problem, solver="gd", iterations=0)
    assert abs(run.loss - float(pinned["J"])) < 1e-11
    assert "guard 'hit wall' has an event at t = 0.36, where the control jumps" in run.reason
    motion = saltus.rollout(problem)
    assert [event[1:] for event in motion.events] == [("o", "hit wall", "o")]
    assert abs(motion.events[0][0] - float(pinned["t"])) < 1e-13
    assert_allclose(motion.final, numbers(pinned["xT"]), rtol=0, atol=1e-12)
    better = saltus.solve(problem, solver="ceres_phases")
    assert 1.29 < better.loss < float(pinned["J"])
    assert better.certificate["verdict"] == "stationary"


@pytest.mark.parametrize("best", REFERENCES["P12"]["poly"]["best"], ids=lambda best: f"{best['hits']} hits")
def test_a_torque_that_is_a_polynomial_in_time(best):
    """The loss is stationary in the six coefficients, which are parameters; the effort is a closed form of them."""
    duration = 1.6
    system = swing_up(lambda t, q, p: [sum(c * (t / duration) ** i for i, c in enumerate(p)) - 9.81 * sin(q[0])],
                      parameters=[f"c{i}" for i in range(6)])
    effort = saltus.cost(
        lambda x, p: 0.02 * duration * sum(p[i] * p[j] / (i + j + 1) for i in range(6) for j in range(6)))
    problem = saltus.HybridProblem(system, initial=[0, 0], parameters=numbers(best["c"]), duration=duration,
                                   costs=[saltus.terminal([-math.pi, 0], weight=[100, 10]), effort], tolerance=1e-14)
    found = saltus.loss_and_gradient(problem)
    assert abs(found.loss - float(best["J"])) < 1e-10
    assert np.abs(found.gradient["parameters"]).max() < 1e-8
    events = saltus.rollout(problem).events
    assert len(events) == best["hits"]
    for event, expected in zip(events, best["events"]):
        assert abs(event[0] - float(expected["t"])) < 1e-11


def test_gradients_agree_with_differences():
    """Of a loss with costs at events, on the way and at the end, through impacts of a controlled system."""
    system = cart_pole()
    terms = [saltus.terminal([0.1, 3.0, None, 0.0], weight=2.0), saltus.effort(1e-3),
             saltus.residuals(lambda x, p: [x[1] - p[2]], at="event", mode="oooo", guard="hit tip_right", before=True)]
    problem = reference_problem("P2", system, costs=terms)
    found = saltus.loss_and_gradient(problem)

    def loss(**changes):
        for name, value in changes.items():
            setattr(problem, name, value)
        return saltus.loss_and_gradient(problem).loss

    for name in ("initial", "parameters", "control"):
        at = np.array(getattr(problem, name), dtype=float)
        gradient = np.asarray(found.gradient[name])
        for place in list(np.ndindex(at.shape))[:9]:
            h = 1e-5
            ends = []
            for step in (-2 * h, -h, h, 2 * h):
                moved = at.copy()
                moved[place] += step
                ends.append(loss(**{name: moved}))
            slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
            assert abs(slope - gradient[place]) < 1e-6 * max(1.0, np.abs(gradient).max()), (name, place)
        loss(**{name: at})


# Every operation that can be recorded, in a gap, whose third derivatives a motion along it needs.
CURVES = {
    "sqrt": lambda x: np.sqrt(1 + x), "exp": lambda x: np.exp(x), "expm1": lambda x: np.expm1(x),
    "log": lambda x: np.log(2 + x), "log1p": lambda x: np.log1p(x), "sin": lambda x: np.sin(x), "cos": lambda x: np.cos(x + 1),
    "tan": lambda x: np.tan(x), "arcsin": lambda x: np.arcsin(x / 2), "arccos": lambda x: np.arccos(x / 2),
    "arctan": lambda x: np.arctan(x), "sinh": lambda x: np.sinh(x), "cosh": lambda x: np.cosh(x + 1),
    "tanh": lambda x: np.tanh(x), "arcsinh": lambda x: np.arcsinh(x + 1), "arccosh": lambda x: np.arccosh(2 + x),
    "arctanh": lambda x: np.arctanh(x / 2), "erf": lambda x: math.erf(x), "power": lambda x: (1 + x) ** 2.5,
    "powers": lambda x: (1 + x) ** (x + 2), "arctan2": lambda x: np.arctan2(x, 1 + x), "divide": lambda x: 1 / (1 + x),
    "abs": lambda x: abs(x - 3), "choice": lambda x: np.where(x < 2, x**2, 4 * x - 4) if isinstance(x, float)
    else saltus.where(x < 2, x**2, 4 * x - 4),
}


@pytest.mark.parametrize("curve", CURVES)
def test_a_bead_on_a_curve_conserves_energy(curve):
    """It slides from rest without friction. Its derivative by the start is compared with differences."""
    g, f, x0, h = 9.81, CURVES[curve], 0.1, 1e-4
    system = saltus.MechanicalSystem(
        coordinates=["x", "y"], mass=lambda q: np.eye(2), force=lambda q: [0, -g],
        contacts={"curve": saltus.Contact(gap=lambda q: q[1] - f(q[0]), restitution=0.0)})

    def problem_from(x):
        return saltus.HybridProblem(system, initial=[x, f(x), 0.0, 0.0], duration=0.15)

    motion = saltus.rollout(problem_from(x0))
    assert motion.events == [] and motion.mode == "n"
    x, y, vx, vy = motion.final
    assert abs(x - x0) > 1e-3
    assert abs(y - f(x)) < 1e-12
    assert abs((vx**2 + vy**2) / 2 + g * (y - f(x0))) < 1e-10
    derivatives = saltus.final_derivatives(problem_from(x0)).by_initial
    ends = [saltus.rollout(problem_from(x0 + step)).final for step in (-2 * h, -h, h, 2 * h)]
    slopes = [f(x0 + step) for step in (-2 * h, -h, h, 2 * h)]
    by_x, slope = ((a - 8 * b + 8 * c - d) / (12 * h) for a, b, c, d in (ends, slopes))
    assert_allclose(derivatives[:, 0] + slope * derivatives[:, 1], by_x, rtol=0, atol=1e-7 * np.abs(by_x).max())


def point_mass(contact=None, **changes):
    given = {
        "coordinates": ["x", "y"], "parameters": ["m", "e", "mu"], "mass": lambda p: [[p[0], 0], [0, p[0]]],
        "force": lambda p: [0, -9.81 * p[0]],
        "contacts": {"ground": contact or saltus.Contact(gap=lambda q: q[1], slide=lambda q: q[0], restitution="e",
                                                         friction="mu")}, **changes}
    return saltus.MechanicalSystem(**given)


def point_problem(initial=(0, 1, 1, 0), parameters=(1, 0.5, 0.2), system=None, **changes):
    given = {"initial": initial, "parameters": parameters, "duration": 1.0, **changes}
    return saltus.HybridProblem(system or point_mass(), **given)


def test_the_mode_at_the_start_is_found():
    for initial, mode in [((0, 1, 0, 0), "o"), ((0, 0, 1, 0), "+"), ((0, 0, -1, 0), "-"), ((0, 0, 0, 0), "s")]:
        assert saltus.rollout(point_problem(initial, duration=0.01)).modes[0] == mode
    assert saltus.rollout(point_problem((0, 0, 1, 0), mode="+", duration=0.1)).mode == "+"


def test_bounces_accumulate_and_what_slides_stops():
    """Closed forms: the bounces end at sqrt(2 y0 / g) (1 + e) / (1 - e); each takes mu (1 + e) |v_n| of the tangential
    velocity, and sliding mu g."""
    e, mu, g, v = 0.5, 0.2, 9.81, 4.0
    motion = saltus.rollout(point_problem((0, 1, v, 0), (1, e, mu), duration=4.0))
    assert motion.mode == "s"
    stop = motion.events[-1]
    assert stop[1:] == ("+", "stop ground", "s")
    falls = math.sqrt(2 / g)
    ends = falls * (1 + e) / (1 - e)
    lost = mu * (1 + e) * g * falls / (1 - e)
    assert abs(stop[0] - (ends + (v - lost) / (mu * g))) < 1e-5


def test_a_contact_ends_where_what_it_is_on_ends():
    """A mass slides over the edge of a table, from which its distance is that from a point then."""
    table = saltus.Contact(
        gap=lambda q: saltus.where(q[0] < 1, q[1], np.sqrt((q[0] - 1) ** 2 + q[1] ** 2)),
        distance=lambda q: q[1], reach=lambda q: 1 - q[0], restitution=0)
    system = saltus.MechanicalSystem(
        coordinates=["x", "y"], parameters=["m", "g"], mass=lambda p: np.diag([p[0], p[0]]),
        force=lambda p: [0, -p[0] * p[1]], contacts={"table": table})
    motion = saltus.rollout(saltus.HybridProblem(system, initial=[0, 0, 0.5, 0], parameters=[2.0, 9.81], duration=3.0))
    assert [event[2] for event in motion.events] == ["end table"]
    assert motion.events[0][0] == pytest.approx(2.0, abs=1e-12)
    assert np.allclose(motion.final, [1.5, -9.81 / 2, 0.5, -9.81], rtol=0, atol=1e-11)


@pytest.mark.parametrize("changes, kind, message", [
    ({"mass": lambda p: [p[0], p[0]]}, ValueError, r"mass: found values of shape \(2,\), expected \(2, 2\)"),
    ({"mass": lambda q, p: [[p[0], q[0]], [0, p[0]]]}, ValueError, "mass: .*of x and y, expected a symmetric matrix"),
    ({"force": lambda p: [0, 0, 0]}, ValueError, r"force: found values of shape \(3,\), expected \(2,\)"),
    ({"force": lambda p: None}, ValueError, "force: .*a return is missing"),
    ({"force": lambda q, w: [0, 0]}, ValueError, "force: found an argument 'w', expected some of t, q, v, u and p"),
    ({"force": lambda q, v: [-abs(v[0]), 0]}, ValueError, "force: found a condition on dx, .*saltus.HybridSystem"),
    ({"mass": lambda q: [[saltus.where(q[0] > 1, 2, 1), 0], [0, 1]]}, ValueError, "mass: found a condition on"),
    ({"mass": lambda q, v: [[v[0], 0], [0, 1]]}, ValueError, "mass: found an argument 'v': mass is a function of q and p"),
    ({"force": lambda q: [1 if q[0] > 0 else 2, 0]}, TypeError, "force: the function decides by a value"),
    ({"contacts": {"ground": lambda q: q[1]}}, TypeError, "contact 'ground': found function, expected a saltus.Contact"),
    ({"contacts": {"ground": saltus.Contact(gap=lambda q: q, restitution=0)}}, ValueError,
     r"contact 'ground': gap: found values of shape \(2,\), expected a number"),
    ({"contacts": {"ground": saltus.Contact(gap=lambda q, t: q[1] - t, restitution=0)}}, ValueError,
     "contact 'ground': gap: found an argument 't': gap is a function of q and p"),
    ({"contacts": {"ground": saltus.Contact(gap=lambda q: q[1], restitution="em")}}, ValueError,
     "contact 'ground': restitution: found parameter 'em', expected some of m, e, mu"),
    ({"contacts": {"ground": saltus.Contact(gap=lambda q: q[1], slide_row=lambda q: [1], restitution=0, friction=0)}},
     ValueError, r"contact 'ground': slide_row: found values of shape \(1,\), expected \(2,\)"),
    ({"coordinates": []}, ValueError, "coordinates: found none"),
    ({"coordinates": ["x", "x"]}, ValueError, "coordinates: found 'x' twice"),
    ({"coordinates": ["x", "dx"]}, ValueError, "coordinates: found a name that is the name of the rate of another"),
    ({"impact_law": "moreau"}, ValueError, "impact_law: found 'moreau', expected 'newton' or 'poisson'"),
    ({"rest_speed": -1.0}, ValueError, "rest_speed: found -1.0"),
])
def test_wrong_systems_are_refused_with_the_reason(changes, kind, message):
    with pytest.raises(kind, match=message):
        point_mass(**changes)


def test_wrong_contacts_are_refused_with_the_reason():
    gap = {"gap": lambda q: q[1], "restitution": 0.5}
    for changes, message in [
        ({"friction": 0.3}, "friction: found it without slide"),
        ({"slide": lambda q: q[0]}, "slide: found it without friction"),
        ({"slide": lambda q: q[0], "slide_row": lambda q: [1, 0], "friction": 0.1}, "slide: found it beside slide_row"),
        ({"restitution": 1.5}, "restitution: found 1.5, expected a number from 0 to 1"),
        ({"slide": lambda q: q[0], "friction": -0.1}, "friction: found -0.1, expected a number of at least 0"),
    ]:
        with pytest.raises(ValueError, match=message):
            saltus.Contact(**{**gap, **changes})
    with pytest.raises(AttributeError, match="no attribute 'mu'"):
        saltus.Contact(**gap).mu = 1


@pytest.mark.parametrize("changes, message", [
    ({"initial": (0, -0.1, 0, 0)}, "initial: contact 'ground' penetrates, its gap is -0.1"),
    ({"parameters": (-1, 0.5, 0.2)}, "mass: found a matrix that is not positive definite"),
    ({"parameters": (1, 1.2, 0.2)}, "contact 'ground': found a restitution of 1.2, expected 0 to 1"),
    ({"parameters": (1, 0.5, -0.2)}, "contact 'ground': found a friction coefficient of -0.2"),
    ({"parameters": (1, np.nan, 0.2)}, "parameters"),
    ({"initial": (0, 1, 0)}, "initial"),
    ({"mode": "oo"}, "mode: found 'oo', expected a letter for each of 1 contacts"),
    ({"mode": "x"}, "mode: found 'x', expected a letter"),
    ({"mode": "s"}, "contact 'ground' is closed in mode 's', and its gap is 1; leave the mode out to have it found"),
])
def test_wrong_problems_are_refused_with_the_reason(changes, message):
    with pytest.raises(ValueError, match=message):
        point_problem(**changes)


@pytest.mark.parametrize("gap", [lambda: 1.0, lambda p: p[0], lambda q: 0 * q[0] + 1])
def test_a_gap_that_depends_on_no_coordinate_is_refused(gap):
    fixed = saltus.MechanicalSystem(coordinates=["x"], parameters=["m"], mass=lambda p: [[p[0]]], force=lambda: [0],
                                    contacts={"wall": saltus.Contact(gap=gap, restitution=0.5)})
    with pytest.raises(ValueError, match="contact 'wall': found a gap that depends on no coordinate"):
        saltus.HybridProblem(fixed, initial=[0, 1], parameters=[1], duration=1.0)


def test_a_gap_that_is_constant_here_and_depends_on_coordinates_elsewhere_is_taken():
    """A step behind x = 3, and no ground before it."""
    step = saltus.MechanicalSystem(
        coordinates=["x", "y"], mass=lambda: np.eye(2), force=lambda: [0, -10],
        contacts={"step": saltus.Contact(gap=lambda q: saltus.where(q[0] > 3, q[1], 1.0), restitution=0.5)})
    problem = saltus.HybridProblem(step, initial=[0, 1, 1, 0], duration=1.0)
    np.testing.assert_allclose(saltus.rollout(problem).final, [1, -4, 1, -10], rtol=1e-10)


def test_a_term_at_an_event_names_mode_and_guard():
    term = saltus.residuals(lambda x: [x[0] - 2], at="event", mode="o", guard="hit ground")
    motion = saltus.rollout(point_problem())
    expected = sum((state[0] - 2) ** 2 for state in (np.interp(event[0], motion.times, [s[0] for s in motion.states])
                                                      for event in motion.events) for state in [[state]])
    assert abs(saltus.loss_and_gradient(point_problem(costs=[term])).loss - expected) < 1e-9
    with pytest.raises(ValueError, match="found guard 'ground' of mode 'o', expected some of hit ground"):
        point_problem(costs=[saltus.residuals(lambda x: x, at="event", mode="o", guard="ground")])


def test_problems_are_pickled_by_their_records():
    problem = point_problem(costs=[saltus.terminal([1.0, None, None, None])])
    copied = pickle.loads(pickle.dumps(problem))
    assert np.array_equal(saltus.rollout(copied).final, saltus.rollout(problem).final)
    assert saltus.loss_and_gradient(copied).loss == saltus.loss_and_gradient(problem).loss
    assert "MechanicalSystem of coordinates" in repr(copied.system)


def pushed(**changes):
    """A mass on the ground that is pushed along it: it slides for 1 s, as the push exceeds the friction."""
    system = point_mass(controls=["f"], force=lambda u, p: [u[0], -9.81 * p[0]])
    given = {"initial": (0, 0, 1, 0), "system": system, "control": np.full((8, 1), 3.0),
             "costs": [saltus.terminal([2.0, None, None, None], weight=10), saltus.effort(0.1)], **changes}
    return point_problem(**given)


def test_solve_certificate_audit_and_feedback_take_a_mechanical_problem():
    """x(T) is linear in the control while the mass slides: the optimum is that of a linear-quadratic problem."""
    run = saltus.solve(pushed(), solver="ceres_phases")
    h, g, mu, target, weight, effort = 1 / 8, 9.81, 0.2, 2.0, 10.0, 0.1
    a = h * (1 - (np.arange(8) + 0.5) * h)
    missed = target - (1 - mu * g / 2)
    scale = weight * missed / (effort * h + weight * a @ a)
    assert_allclose(np.ravel(run.control), scale * a, rtol=1e-6)
    assert run.certificate["verdict"] == "stationary"
    assert [event[2] for event in run.events] == []
    problem = pushed()

    def step(x, u, p, h):  # an implicit step along the ground
        v = x[2] + h * (u[0] / p[0] - p[2] * g)
        return "+", [x[0] + h * v, 0.0, v, 0.0]

    audit = saltus.audit(problem, step=step, steps=16)
    assert audit.verdict == "consistent"
    regulator = saltus.track(problem, np.eye(4), np.eye(1), np.eye(4))
    with pytest.raises(ValueError, match="Q: the modes of a mechanical system have one state, expected one matrix"):
        saltus.track(problem, {"s": np.eye(4)}, np.eye(1), np.eye(4))
    noise = 1e-6 * np.diag([1, 0, 1, 0])
    # While it slides, the error of the position grows with that of the velocity: var x + T^2 var v.
    opened, closed = saltus.propagate(problem, noise), saltus.propagate(problem, noise, regulator=regulator)
    assert_allclose(opened.covariances[-1][0, 0], 2e-6, rtol=1e-10)
    assert closed.covariances[-1][0, 0] < 0.7 * opened.covariances[-1][0, 0]
    runs = saltus.noisy_runs(problem, noise, regulator=regulator, samples=400, seed=3)
    assert runs.failed == 0
    assert abs(runs.covariance[0, 0] / closed.covariances[-1][0, 0] - 1) < 0.25


def test_a_file_of_bodies_is_the_problem_of_the_program():
    """The toss for which the file has its targets is (2, 1) m/s and -2 rad/s."""
    path = SOURCE / "problems" / "tossed_box.yaml"
    problem = saltus.load_bodies(path)
    assert problem.system.coordinates == ["box.x", "box.y", "box.angle"]
    assert problem.optimize == ["dbox.x", "dbox.y", "dbox.angle"]
    assert_allclose(problem.initial, [-1, 0.6, 0.3, 1.9, 1.2, -2.2])
    run = saltus.solve(problem, solver="ceres_lm")
    assert run.loss < 1e-18
    assert_allclose(run.initial[3:], [2, 1, -2], rtol=1e-7)
    copied = pickle.loads(pickle.dumps(problem))
    assert saltus.loss_and_gradient(copied).loss == saltus.loss_and_gradient(problem).loss > 0


def test_a_dict_of_bodies_with_a_control_has_its_names_and_bounds():
    data = {"name": "push", "duration": 1, "steps": 4, "gravity": [0, -10], "contact": {"restitution": 0, "friction": 0.5},
            "bodies": [{"name": "box", "box": [0.1, 0.1], "mass": 2, "position": [0, 0.1], "velocity": [1, 0]}],
            "planes": [{"point": [0, 0], "normal": [0, 1]}],
            "control": {"bodies": ["box"], "initial": [[12, 0, 0]], "max": 30},
            "objective": {"terminal": [{"body": "box", "quantity": "position", "target": [2, 0.1]}], "effort": 0.01},
            "optimize": "control"}
    problem = saltus.load_bodies(data)
    assert problem.system.controls == ["box.force_x", "box.force_y", "box.torque"]
    assert problem.bounds["box.force_x"] == [-30, 30] and problem.bounds["box.torque"] == [-np.inf, np.inf]
    # It slides at a = 12 / 2 - 0.5 * 10 = 1.
    assert_allclose(saltus.rollout(problem).final[0], 1.5, rtol=1e-12)
    assert_allclose(saltus.loss_and_gradient(problem).loss, 0.25 + 0.01 * 144, rtol=1e-12)
    run = saltus.solve(problem)
    assert np.abs(np.asarray(run.control)[:, :2]).max() <= 30
    with pytest.raises(saltus.SceneError, match=r"scene: bodies\[0\].mass: .*expected a mass above zero"):
        saltus.load_bodies({**data, "bodies": [{**data["bodies"][0], "mass": -1}]})


def two_boxes(lower, upper, **scene):
    return {"name": "two", "bodies": [{"name": "a", "mass": 1, **lower}, {"name": "b", "mass": 1, **upper}],
            "objective": {"terminal": []}, "optimize": "none", **scene}


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-3, 0.05, 0.3])
@pytest.mark.parametrize("width, shift", [(0.2, 0.0), (0.2, 1e-9), (0.2, 1e-4), (0.15, 0.05), (0.3, 0.1)])
def test_boxes_with_sides_in_one_line_do_not_pass_through_each_other(width, shift, gap):
    """The upper box falls on one of equal width, or of another one with a side in the same line, and stays on it."""
    problem = saltus.load_bodies(two_boxes(
        {"box": [0.2, 0.1], "position": [0, 0.1]}, {"box": [width, 0.1], "position": [shift, 0.3 + gap]},
        gravity=[0, -9.81], planes=[{"point": [0, 0], "normal": [0, 1]}], duration=0.5, contact={"restitution": 0, "friction": 0.3}))
    motion = saltus.rollout(problem)
    assert_allclose(motion.final[[1, 4]], [0.1, 0.3], atol=1e-9)


@pytest.mark.parametrize("shift", [0.0, 1e-7, 0.05])
def test_boxes_that_meet_head_on_rebound(shift):
    """Closed form: at half of the speed from t = 0.2 on; a shift turns them, and keeps their momentum."""
    problem = saltus.load_bodies(two_boxes(
        {"box": [0.1, 0.1], "position": [-0.3, 1], "velocity": [1, 0]},
        {"box": [0.1, 0.1], "position": [0.3, 1 + shift], "velocity": [-1, 0]}, duration=0.5, contact={"restitution": 0.5, "friction": 0}))
    motion = saltus.rollout(problem)
    assert abs(motion.events[0][0] - 0.2) < 1e-12
    assert_allclose(motion.final[6] + motion.final[9], 0, atol=1e-12)
    if shift < 1e-6:
        assert_allclose(motion.final[[6, 9]], [-0.5, 0.5], atol=1e-5)


@pytest.mark.parametrize("overlap", [1e-6, 0.01, 0.1])
@pytest.mark.parametrize("shift", [0.0, 1e-3])
def test_equal_boxes_that_overlap_at_the_start_are_refused(overlap, shift):
    with pytest.raises(ValueError, match="penetrates, its gap is -"):
        saltus.rollout(saltus.load_bodies(two_boxes(
            {"box": [0.2, 0.1], "position": [0, 0.1]}, {"box": [0.2, 0.1], "position": [shift, 0.3 - overlap]}, duration=0.1)))
