"""Drag and springs in scenes."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

import saltus

mpmath = pytest.importorskip("mpmath")

MASS, DRAG, RADIUS, E, MU, G = 0.5, 0.3, 0.1, 0.8, 0.05, 9.81


def thrown(**keys):
    """A disc that is thrown over the ground, with drag."""
    scene = {
        "name": "thrown", "duration": 2.5, "steps": 50, "gravity": [0, -G], "optimize": "velocity",
        "bodies": [{"name": "ball", "radius": RADIUS, "mass": MASS, "position": [0, 1], "velocity": [2, 3]}],
        "planes": [{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
        "contact": {"restitution": E, "friction": MU}, "forces": [{"drag": {"body": "ball", "linear": DRAG}}],
        "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [3, 1]}]}}
    return {**scene, **keys}


def thrown_in_closed_form(duration):
    """Returns [x y vx vy] at the end and the times of the impacts, with 30 digits."""
    mpmath.mp.dps = 30
    k, g, radius = mpmath.mpf("0.3") / mpmath.mpf("0.5"), mpmath.mpf("9.81"), mpmath.mpf("0.1")
    x, y, vx, vy, now, times = mpmath.mpf(0), mpmath.mpf(1), mpmath.mpf(2), mpmath.mpf(3), mpmath.mpf(0), []
    duration = mpmath.mpf(duration)

    def flight(t):
        fall = mpmath.exp(-k * t)
        return (x + vx * (1 - fall) / k, y + (vy + g / k) * (1 - fall) / k - g * t / k, vx * fall, (vy + g / k) * fall - g / k)

    while True:
        top = mpmath.log(1 + k * vy / g) / k if vy > 0 else mpmath.mpf(0)  # from where the height falls
        low, high = top, top + 1
        while flight(high)[1] > radius:
            high += 1
        for _ in range(110):
            middle = (low + high) / 2
            low, high = (middle, high) if flight(middle)[1] > radius else (low, middle)
        if now + low >= duration:
            return [float(one) for one in flight(duration - now)], [float(one) for one in times]
        now += low
        times.append(now)
        x, y, vx, vy = flight(low)
        y, vx = radius, vx - min(mpmath.mpf("0.05") * (1 + mpmath.mpf("0.8")) * -vy, vx)
        vy = -mpmath.mpf("0.8") * vy


def test_a_thrown_disc_bounces_as_in_closed_form():
    motion = saltus.rollout(thrown())
    state, times = thrown_in_closed_form("2.5")
    assert len(times) == 4 and [(event["a"], event["b"]) for event in motion.events] == [("ball", "ground")] * 4
    assert np.allclose([event["time"] for event in motion.events], times, rtol=0, atol=1e-13)
    assert np.allclose(motion.states[-1][0], state, rtol=0, atol=1e-12)


@pytest.mark.parametrize("contact, tolerance", [("event", 1e-12), ("ncp_restitution", 0.01)])
def test_a_thrown_disc_of_a_material_bounces_by_its_pair_beside_drag(contact, tolerance):
    scene = thrown(contact={"restitution": 0.3, "friction": 0.0}, duration=2.2, steps=3000,
                   materials={"felt": {"restitution": 0.1, "friction": 0.9}, "steel": {"restitution": 0.2, "friction": 0.9}},
                   pairs=[{"between": ["felt", "steel"], "restitution": E, "friction": MU}])
    scene["bodies"][0]["material"] = "steel"
    scene["planes"][0]["material"] = "felt"
    state, times = thrown_in_closed_form("2.2")
    assert len(times) >= 2
    assert np.allclose(saltus.rollout(scene, contact).states[-1][0], state, rtol=0, atol=tolerance)


def test_a_spring_without_length_and_with_damping_is_an_oscillator():
    k, c, m, x0 = 40.0, 0.7, 0.5, 0.3
    scene = thrown(gravity=[0, 0], planes=[], bodies=[
        {"name": "ball", "radius": RADIUS, "mass": m, "position": [1 + x0, 2], "velocity": [0, 0]}],
        forces=[{"spring": {"body": "ball", "to": [1, 2], "stiffness": k, "damping": c}}])
    decay, omega = c / (2 * m), math.sqrt(k / m - (c / (2 * m)) ** 2)
    for t, state in zip(np.linspace(0, 2.5, 51), saltus.rollout(scene).states):
        x = x0 * math.exp(-decay * t) * (math.cos(omega * t) + decay / omega * math.sin(omega * t))
        v = -x0 * math.exp(-decay * t) * (omega + decay**2 / omega) * math.sin(omega * t)
        assert np.allclose(state[0], [1 + x, 2, v, 0], rtol=0, atol=1e-13)


def test_two_discs_on_a_spring_oscillate_about_its_length():
    k, c, length, masses, d0 = 60.0, 0.4, 1.0, (0.5, 1.5), 1.2
    scene = thrown(gravity=[0, 0], planes=[], bodies=[
        {"name": "ball", "radius": 0.1, "mass": masses[0], "position": [0, 0], "velocity": [0.3, 0]},
        {"name": "other", "radius": 0.1, "mass": masses[1], "position": [d0, 0], "velocity": [0.3, 0]}],
        forces=[{"spring": {"body": "ball", "to": "other", "stiffness": k, "length": length, "damping": c}}])
    m = masses[0] * masses[1] / sum(masses)
    decay, omega = c / (2 * m), math.sqrt(k / m - (c / (2 * m)) ** 2)
    for t, state in zip(np.linspace(0, 2.5, 51), saltus.rollout(scene).states):
        stretch = (d0 - length) * math.exp(-decay * t) * (math.cos(omega * t) + decay / omega * math.sin(omega * t))
        center = masses[1] * d0 / sum(masses) + 0.3 * t
        ends = center + np.array([-masses[1], masses[0]]) / sum(masses) * (length + stretch)
        assert np.allclose(state[:, 0], ends, rtol=0, atol=1e-11)
        assert np.all(state[:, 1] == 0)


def crowded(**keys):
    """Two discs on springs, with drag, that meet each other and a wall."""
    return thrown(**{**dict(gravity=[0, -1.0], duration=1.0, steps=100, bodies=[
        {"name": "ball", "radius": 0.1, "mass": 0.5, "position": [0, 1], "velocity": [2.5, 0.2]},
        {"name": "other", "radius": 0.15, "mass": 1.0, "position": [0.6, 1.02], "velocity": [-0.5, 0]}],
        planes=[{"name": "wall", "point": [0.95, 0], "normal": [-1, 0]}],
        forces=[{"drag": {"body": "ball", "linear": 0.2}},
                {"spring": {"body": "other", "to": [0.4, 1.4], "stiffness": 3.0, "length": 0.2, "damping": 0.1}},
                {"spring": {"body": "ball", "to": "other", "stiffness": 0.8}}],
        contact={"restitution": 0.7, "friction": 0.1},
        objective={"terminal": [{"body": "ball", "quantity": "position", "target": [1, 1]},
                                {"body": "other", "quantity": "velocity", "target": [0, 0]}]}), **keys})


def loss_after(scene, contact, body, key, component, change):
    data = saltus.Scene(scene).to_dict()
    data["bodies"][body][key] = [value + change * (j == component) for j, value in enumerate(data["bodies"][body][key])]
    return saltus.loss_and_gradient(data, contact).loss


@pytest.mark.parametrize("contact", ["event", "direct", "qcqp", "xpbd"])
def test_gradients_are_those_of_differences(contact):
    scene, h = crowded(**({"contact": {"restitution": 0.7}} if contact == "direct" else {})), 1e-5
    found = saltus.loss_and_gradient(scene, contact)
    if contact == "event":
        assert len(saltus.rollout(scene).events) >= 2
    for key in ("position", "velocity"):
        for body in range(2):
            for j in range(2):
                ends = [loss_after(scene, contact, body, key, j, step) for step in (h, -h)]
                by = (ends[0] - ends[1]) / (2 * h)
                assert found.gradient[key][body][j] == pytest.approx(by, rel=2e-6, abs=2e-7)


@pytest.mark.parametrize("contact", ["event", "qcqp"])
def test_gradients_by_parameters_are_those_of_differences(contact):
    scene = saltus.Scene(crowded())
    found = saltus.loss_and_gradient(scene, contact).gradient["parameters"]

    def difference(change):
        h = 1e-5
        return (saltus.loss_and_gradient(change(h), contact).loss - saltus.loss_and_gradient(change(-h), contact).loss) / (2 * h)

    def heavier(h):
        data = scene.to_dict()
        data["bodies"][1]["mass"] += h
        return data

    for name in ("restitution", "friction"):
        by = difference(lambda h, name=name: scene.replace(contact={name: scene.to_dict()["contact"][name] + h}))
        assert found[name] == pytest.approx(by, rel=1e-5, abs=1e-7)
    assert found["gravity"][1] == pytest.approx(difference(lambda h: scene.replace(gravity=[0, -1.0 + h])), rel=1e-5)
    assert found["mass"][1] == pytest.approx(difference(heavier), rel=1e-5)


@pytest.mark.parametrize("contact, unit", [("event", 1.0), ("event", 1000.0), ("xpbd", 1000.0)])
def test_drag_is_identified(contact, unit):
    """A recording of the model itself, with lengths in units of m or mm."""
    def scaled(drag, restitution):
        scene = thrown(gravity=[0, -G * unit], contact={"restitution": restitution}, steps=200, duration=1.5)
        scene["bodies"] = [{"name": "ball", "radius": RADIUS * unit, "mass": MASS, "position": [0, unit],
                            "velocity": [2 * unit, 3 * unit]}]
        scene["forces"] = [{"drag": {"body": "ball", "linear": drag}}]
        return saltus.Scene(scene)

    motion = saltus.rollout(scaled(DRAG, E), contact)
    recording = {"time": motion.times[1:], "body": ["ball"] * 200, "position": motion.states[1:, 0, :2], "sigma": 1e-4 * unit}
    fit = saltus.identify(scaled(0.1, 0.7), recording, unknown="drag.ball, restitution", contact=contact, known_start=True)
    assert fit.estimates["drag.ball"] == pytest.approx(DRAG, rel=1e-5)
    assert fit.estimates["restitution"] == pytest.approx(E, rel=1e-5)


def in_flight(steps):
    scene = crowded(planes=[])
    scene["bodies"][1]["position"] = [0.6, 1.8]
    return {**scene, "steps": steps, "duration": 0.5}


def test_all_models_converge_to_event():
    exact = saltus.rollout(in_flight(60)).states[-1][:, :4]
    for contact in saltus.contact_models():
        if contact == "event":
            continue
        errors = []
        for steps in (60, 120, 240):
            try:
                end = saltus.rollout(in_flight(steps), contact).states[-1][:, :4]
            except ValueError as refused:  # friction, or two discs, which some models do not have
                assert "friction" in str(refused) or "static" in contact
                end = saltus.rollout({**in_flight(steps), "contact": {"restitution": 0.7}}, contact).states[-1][:, :4]
            errors.append(np.abs(end - exact).max())
        assert errors[0] < 0.02, contact
        assert errors[1] < 0.55 * errors[0] and errors[2] < 0.55 * errors[1], (contact, errors)


@pytest.mark.parametrize("contact", [
    "lcp", "lcp_kkt", "convex", "convex_toi", "direct", "direct_toi", "toi_velocity", "ncp_restitution", "qcqp", "xpbd"])
def test_models_with_restitution_converge_to_event_through_impacts(contact):
    scene = crowded(contact={"restitution": 0.7})
    exact = saltus.rollout(scene)
    assert len(exact.events) >= 2
    errors = [np.abs(saltus.rollout({**scene, "steps": steps}, contact).states[-1][:, :4] - exact.states[-1][:, :4]).max()
              for steps in (1000, 16000)]
    assert errors[1] < 5e-3 and errors[1] < 0.5 * errors[0]


def pushed(**keys):
    """A push moves a disc with drag onto another one on a spring."""
    return {
        "name": "pushed", "duration": 1.0, "steps": 40, "optimize": "control", "contact": {"restitution": 0.9},
        "bodies": [{"name": "striker", "radius": 0.1, "mass": 0.5, "position": [-1, 0]},
                   {"name": "puck", "radius": 0.1, "mass": 0.5, "position": [0, 0.03]}],
        "forces": [{"drag": {"body": "striker", "linear": 0.8}}, {"drag": {"body": "puck", "linear": 0.4}},
                   {"spring": {"body": "puck", "to": [0, 0.03], "stiffness": 2.0}}],
        "control": {"bodies": ["striker"], "initial": [[3.5, 0]]},
        "objective": {"terminal": [{"body": "puck", "quantity": "position", "target": [0.5, 0.1]}], "effort": 0.01}, **keys}


def test_solvers_find_a_certified_optimum():
    runs = {solver: saltus.solve(pushed(), solver=solver) for solver in ("ceres_phases", "auto")}
    for run in runs.values():
        assert run.termination == "converged"
        assert run.certificate.verdict in ("stationary", "stationary_on_grid")
        assert [(impact["a"], impact["b"]) for impact in run.certificate.impacts] == [("striker", "puck")]
        assert run.final_loss < 0.2 * run.initial_loss
    # Shooting on equal intervals is no better.
    shot = saltus.solve(pushed(), solver="ceres_lm", iterations=200)
    assert runs["ceres_phases"].final_loss <= shot.final_loss * (1 + 1e-6)
    # The optimum is worth that in the simulation of the scene, too.
    best = runs["ceres_phases"]
    assert best.exact_loss == pytest.approx(best.final_loss, rel=1e-9)


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt"])
def test_a_limit_of_the_speed_holds_between_the_ends_of_intervals(solver):
    """On a spring with 2 rad/s, from -1/2, the speed is greatest at 0, after pi / 12: v^2 + 1 there of the v at the start."""
    scene = {"name": "swing", "duration": 0.5, "steps": 4, "optimize": "velocity",
             "bodies": [{"name": "disc", "radius": 0.1, "mass": 1, "position": [-0.5, 0], "velocity": [0.5, 0]}],
             "forces": [{"spring": {"body": "disc", "to": [0, 0], "stiffness": 4}}],
             "objective": {"terminal": [{"body": "disc", "quantity": "position", "target": [5, 0]}],
                           "limits": [{"body": "disc", "speed": {"max": 2}}]}}
    run = saltus.solve(scene, solver=solver)
    assert run.termination == "converged", run.reason
    at_end = -0.5 * math.cos(1) + math.sqrt(3) / 2 * math.sin(1)
    assert run.final_loss == pytest.approx((at_end - 5) ** 2, rel=1e-8)


def test_running_costs_beside_drag_are_those_of_fine_steps():
    scene = pushed()
    scene["objective"]["running"] = [{"body": "puck", "quantity": "position", "weight": 3.0,
                                      "target": [[0.0, 0, 0], [0.43, 0.2, 0], [1.0, 0.1, 0.1]]}]
    found = saltus.solve(scene, solver="ceres_phases", iterations=0).initial_loss
    assert saltus.loss_and_gradient(saltus.hybrid_problem(scene)).loss == pytest.approx(found, rel=1e-11)
    fine = saltus.rollout({**pushed(), "steps": 4096})
    t = np.linspace(0, 1, 4097)
    target = np.stack([np.interp(t, [0, 0.43, 1], [0, 0.2, 0.1]), np.interp(t, [0, 0.43, 1], [0, 0, 0.1])], axis=1)
    square = np.sum((fine.states[:, 1, :2] - target) ** 2, axis=1)
    end = fine.states[-1, 1, :2] - [0.5, 0.1]
    expected = 3.0 * np.trapz(square, t) + end @ end + 0.01 * 3.5**2
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("keys", [{}, {"forces": pushed()["forces"][:2] + [
    {"spring": {"body": "puck", "to": [0, -0.3], "stiffness": 2.0, "length": 0.2}}]},
    {"planes": [{"name": "wall", "normal": [-1, 0],
                 "motion": {"times": [0, 0.5, 0.8, 2], "positions": [[0.7, 0], [0.6, 0], [0.55, 0], [0.3, 0]]}}]}], ids=["linear", "length", "path"])
def test_the_hybrid_problem_has_free_parameters_beside_drag(keys):
    names = [*(["drag.puck"] if "planes" not in keys else []), "mass.puck", "mass.striker", "gravity.x", "restitution", "radius.puck"]
    scene = pushed(**keys, optimize=["control", *({"parameter": name} for name in names)])
    problem = saltus.hybrid_problem(scene)
    found = saltus.loss_and_gradient(problem)
    assert problem.system.parameters == names
    assert found.loss == pytest.approx(saltus.rollout(pushed(**keys)).loss, rel=1e-9)

    def loss(name, by):
        other = pushed(**keys)
        thing = {body["name"]: body for body in other["bodies"]}.get(name.split(".")[-1])
        if name == "drag.puck":
            other["forces"] = [other["forces"][0], {"drag": {"body": "puck", "linear": 0.4 + by}}, *other["forces"][2:]]
        elif name == "gravity.x":
            other["gravity"] = [by, 0]
        elif name == "restitution":
            other["contact"] = {"restitution": 0.9 + by}
        else:
            thing[name.split(".")[0]] += by
        return saltus.rollout(other).loss

    for name, derivative in zip(names, found.gradient.parameters):
        h = 1e-3
        rule = 8 * (loss(name, h) - loss(name, -h)) - (loss(name, 2 * h) - loss(name, -2 * h))
        assert derivative == pytest.approx(rule / (12 * h), rel=1e-5, abs=1e-8), name


def test_scenes_keep_their_forces():
    scene = saltus.Scene(crowded())
    data = scene.to_dict()
    assert data["forces"][1] == {"spring": {"body": "other", "to": [0.4, 1.4], "stiffness": 3.0, "length": 0.2, "damping": 0.1}}
    assert data["forces"][2]["spring"]["to"] == "other"
    assert saltus.Scene(data) == scene


@pytest.mark.parametrize("forces, message", [
    ([{"drag": {"body": "ball"}}], r"forces\[0\].drag.linear: found no such key"),
    ([{"drag": {"body": "bal", "linear": 1}}], r"forces\[0\].drag.body: .*did you mean ball"),
    ([{"drag": {"body": "ball", "linear": -1}}], r"forces\[0\].drag.linear: found -1, expected a number >= 0"),
    ([{"drag": {"body": "ball", "linear": 1}}] * 2, r"forces\[1\].drag.body: found it again, expected the drag of each body once"),
    ([{"spring": {"body": "ball", "to": "ball", "stiffness": 1}}], r"forces\[0\].spring.to: found the body itself"),
    ([{"drag": {"body": "ball", "linear": 1}, "spring": {}}], r"forces\[0\]: .*expected one key, drag or spring"),
])
def test_wrong_forces_are_refused(forces, message):
    with pytest.raises(saltus.SceneError, match=message):
        saltus.Scene(thrown(forces=forces))


def test_what_is_not_supported_is_refused_with_the_alternative():
    with pytest.raises(ValueError, match="drag or springs, whose flights this solver does not support: use ceres_phases"):
        saltus.solve(pushed(), solver="hmp")
    with pytest.raises(ValueError, match="which this solver takes under the contact model event only: use ceres_lm"):
        saltus.solve(pushed(), contact="lcp", solver="ceres_phases")
    with pytest.raises(ValueError, match="identify or sweep them"):
        saltus.solve(pushed(optimize=["control", {"parameter": "restitution"}]), solver="ceres_lm")
    walls = {**thrown(), "segments": [{"name": "s", "from": [5, 0], "to": [5, 2]}]}
    with pytest.raises(ValueError, match="drag or springs beside walls that end.*use a time-stepping model such as lcp"):
        saltus.rollout(walls)
    assert np.isfinite(saltus.rollout(walls, "lcp").states).all()
    with pytest.raises(saltus.SceneError, match="forces: found drag or springs in a scene with a table"):
        saltus.Scene({**thrown(), "table": {"friction": 0.1}})
    with pytest.raises(RuntimeError, match="do not come to rest.*use a time-stepping model with short steps, such as ncp"):
        saltus.rollout(thrown(duration=30.0))


def test_bounces_that_do_not_end_are_refused_with_their_step():
    """With w = g / k, a bounce at the speed v lasts t with (v + w) (1 - exp(-k t)) = g t, and ends at (v + w) exp(-k t) - w."""
    k, e, now, v = DRAG / MASS, 0.5, 0.0, 0.0
    w, height = G / k, 0.9
    while now == 0 or v > 1e-5:
        landing = brentq(lambda t: height + (v + w) * (1 - math.exp(-k * t)) / k - w * t, 1e-9 if now == 0 else v / G, 1 + v)
        now, v, height = now + landing, -e * ((v + w) * math.exp(-k * landing) - w), 0.0
    scene = thrown(duration=now / 0.305, steps=100, contact={"restitution": e, "friction": 0})  # within the step from 30%
    scene["bodies"][0]["velocity"] = [0, 0]
    with pytest.raises(RuntimeError, match=r"step 30 of event: impacts accumulate .*drag.* ncp \(ball\)"):
        saltus.rollout(scene)


def test_the_speed_of_a_disc_without_drag_is_limited_beside_others():
    """Velocities are linear between the nodes where no force depends on the state."""
    slow = pushed(duration=2.0)
    slow["forces"] = [{"drag": {"body": "puck", "linear": 0.4}}]
    slow["objective"]["limits"] = [{"body": "striker", "speed": {"max": 0.9}, "at": "always"}]
    run = saltus.solve(slow)
    assert run.termination == "converged"
    problem = saltus.hybrid_problem(slow)
    problem.control, problem.durations = np.reshape(run.control, (len(run.durations), -1)), run.durations
    motion, at = saltus.rollout(problem), problem.system.states["flight"].index("striker.vx")
    speeds = np.linalg.norm(np.asarray(motion.states)[:, at:at + 2], axis=1)
    assert speeds.max() == pytest.approx(0.9, abs=1e-5)
    free = saltus.solve({**slow, "objective": {**slow["objective"], "limits": []}})
    assert run.final_loss > free.final_loss * (1 + 1e-3)
