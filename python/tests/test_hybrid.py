"""Hybrid systems whose functions are ordinary Python."""

import math
from math import cos, sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose

import saltus

# Exact values: closed forms, and Taylor series of order 56 with 84 digits.


def ball(**changes):
    return saltus.HybridSystem(**{
        "states": {"flight": ["y", "v"]}, "controls": ["f"], "parameters": ["g", "e"],
        "flow": {"flight": lambda t, x, u, p: [x[1], -p[0] + u[0]]},
        "guards": {"flight": {"ground": lambda t, x, p: x[0]}},
        "resets": {"flight": {"ground": lambda t, x, p: ("flight", [x[0], -p[1] * x[1]])}},
        **changes,
    })


def ball_problem(**changes):
    return saltus.HybridProblem(**{"system": ball(), "mode": "flight", "initial": [1.3, 0.4], "parameters": [9.81, 0.8],
                                   "duration": 2.0, **changes})


def hopper(m=1.0, l0=1.0, g=10.0):
    def spring(x, k):  # a helper that has imported functions of math by name
        return k / m * (l0 / sqrt(x[0] ** 2 + x[1] ** 2) - 1)

    def flight(t, x, u, p):
        return [x[2], x[3], 0, -g]

    def touch_down(t, x, p):
        s, c = math.sin(p[1]), np.cos(p[1])
        return "stance", [-l0 * s, l0 * c, x[2], x[3], x[0] + l0 * s]

    return saltus.HybridSystem(
        states={"down": ["x", "y", "vx", "vy"], "stance": ["xr", "y", "vx", "vy", "xf"], "up": ["x", "y", "vx", "vy"]},
        parameters=["k", "theta"],
        flow={"down": flight, "up": flight,
              "stance": lambda t, x, u, p: [x[2], x[3], spring(x, p[0]) * x[0], spring(x, p[0]) * x[1] - g, 0]},
        guards={"down": {"touch-down": lambda t, x, p: x[1] - l0 * cos(p[1])},
                "stance": {"lift-off": lambda t, x, p: l0**2 - x[0] ** 2 - x[1] ** 2},
                "up": {"apex": lambda t, x, p: x[3]}},
        resets={"down": {"touch-down": touch_down},
                "stance": {"lift-off": lambda t, x, p: ("up", [x[0] + x[4], x[1], x[2], x[3]])},
                "up": {"apex": lambda t, x, p: ("down", x)}})


def hopper_problem():
    return saltus.HybridProblem(hopper(), mode="down", initial=[0, 1.18, 1.02, -0.1],
                                parameters=[100, math.radians(10)], duration=2.1)


def test_events_that_accumulate_may_lead_on():
    """The time of accumulation is 3 sqrt(2 y0 / g) at restitution 0.5; the ball slides on at a quarter of its speed."""
    states = ["x", "y", "v"]
    changes = {
        "states": {"flight": states, "rest": states}, "controls": [],
        "flow": {"flight": lambda t, x, u, p: [1, x[2], -p[0]], "rest": lambda t, x, u, p: [0.25, 0, 0]},
        "guards": {"flight": {"ground": lambda t, x, p: x[1]}},
        "resets": {"flight": {"ground": lambda t, x, p: ("flight", [x[0], x[1], -p[1] * x[2]])}},
    }
    system = ball(**changes, on_accumulation={"flight": {"ground": "rest"}})
    problem = saltus.HybridProblem(system, mode="flight", initial=[0, 1, 0], parameters=[9.8, 0.5], duration=2.0)
    motion = saltus.rollout(problem)
    assert motion.mode == "rest"
    assert_allclose(motion.final, [0.5 + 0.75 * 3 * sqrt(2 / 9.8), 0, 0], atol=1e-8)
    with pytest.raises(ValueError, match="on_accumulation of mode 'flight': found mode 'ground'"):
        ball(**changes, on_accumulation={"flight": {"ground": "ground"}})
    with pytest.raises(ValueError, match="on_accumulation of mode 'flight': found guard 'wall', expected some of ground"):
        ball(**changes, on_accumulation={"flight": {"wall": "rest"}})


def fly(t, s, x, u, p):
    return [x[0] + s * (x[1] + s * (u[0] - p[0]) / 2), x[1] + s * (u[0] - p[0])]


def test_a_closed_form_of_another_flow():
    with pytest.raises(ValueError, match="fly: found mode 'rest', expected some of flight"):
        ball(fly={"rest": fly})
    with pytest.raises(ValueError, match="fly of mode 'flight'"):
        ball(fly={"flight": lambda t, s, x, u, p: [x[0]]})
    problem = ball_problem(system=ball(fly={"flight": lambda t, s, x, u, p: [x[0] + s, x[1]]}))
    with pytest.raises(RuntimeError, match="Fly is no closed form of the flow of mode 'flight'"):
        saltus.rollout(problem)


@pytest.mark.parametrize("changes", [{}, {"fly": {"flight": fly}}], ids=["integrated", "closed form"])
def test_ball(changes):
    problem = ball_problem(system=ball(**changes))
    motion = saltus.rollout(problem)
    assert motion.mode == "flight"
    assert_allclose(motion.final, [0.13461823752513323273, -2.8056342918771302282], rtol=1e-12)
    assert [event[1:] for event in motion.events] == [("flight", "ground", "flight")] * 2
    assert_allclose([event[0] for event in motion.events], [0.55720308415835660801, 1.3834884673336435927], rtol=1e-13)
    assert len(motion.states) == len(motion.times) == len(motion.modes)
    assert motion.times[0] == 0 and motion.times[-1] == 2.0
    assert motion.remark == ""
    d = saltus.final_derivatives(problem)
    assert_allclose(d.by_initial, [[2.203907929171727461, 0.37586110739508880863], [6.2738614352328119871, 1.2558149412938965132]],
                    rtol=1e-11)
    assert_allclose(d.by_parameters, [[-0.29366019504140142609, 7.8951741884835833065],
                                      [-1.168601440794836332, 18.238184120136521969]], rtol=1e-11)
    assert_allclose(d.by_duration, [-2.8056342918771302282, -9.81], rtol=1e-11)
    assert d.by_control.shape == (2, 1, 1)


def test_control_and_costs():
    problem = ball_problem(control=np.linspace(-1, 1, 40)[:, None])
    problem.costs = [saltus.terminal([1, 0], weight=100), saltus.effort(0.0625),
                     saltus.residuals(lambda x, t: [0.1 * x[0] * t], at="steps"),
                     saltus.residuals(lambda x, p: [p[1] * x[1]], at="event", mode="flight", guard="ground"),
                     lambda x, p: [x[0] * np.exp(-p[1])]]
    found = saltus.loss_and_gradient(problem)
    assert found.gradient.control.shape == (40, 1)
    width = 1e-5

    def difference(set_value):
        losses = []
        for side in (1, -1):
            other = ball_problem(control=np.array(problem.control), costs=problem.costs)
            set_value(other, side * width)
            losses.append(saltus.loss_and_gradient(other).loss)
        return (losses[0] - losses[1]) / (2 * width)

    def push(other, by):
        other.control[7, 0] += by

    assert_allclose(found.gradient.control[7, 0], difference(push), rtol=1e-7)
    for i in range(2):
        assert_allclose(found.gradient.initial[i],
                        difference(lambda o, by: setattr(o, "initial", np.array([1.3, 0.4]) + by * np.eye(2)[i])), rtol=1e-7)
        assert_allclose(found.gradient.parameters[i],
                        difference(lambda o, by: setattr(o, "parameters", np.array([9.81, 0.8]) + by * np.eye(2)[i])), rtol=1e-7)
    assert_allclose(found.gradient.duration, difference(lambda o, by: setattr(o, "duration", 2.0 + by)), rtol=1e-7)


def test_hopper_with_states_of_different_size():
    motion = saltus.rollout(hopper_problem())
    assert motion.mode == "stance"
    assert_allclose(motion.final, [0.1434523421370904859, 0.8489130552112413343, 1.139255100795511741, 2.107296555291679943,
                                   1.899190288412259795], rtol=1e-10)
    d = saltus.final_derivatives(hopper_problem())
    assert_allclose(d.by_parameters[:, 0], [-0.0440830868415837872, 0.001933852435766758286, -0.246974037237585231,
                                            0.08386994428202119259, -0.04305230578443869807], rtol=1e-9)
    assert_allclose(d.by_initial[:, 2], [10.29394884901157645, 2.743974023850606226, 52.98508175808313899,
                                         -12.01121008268199654, 9.53254604371169236], rtol=1e-9)


def test_answer_of_the_tutorial_is_a_local_minimum():
    """Restitution with which a ball from 50 m is at 20 m after 15 s: published as 0.8666."""
    problem = saltus.HybridProblem(ball(), mode="flight", initial=[50, 0], parameters=[9.8, 0.866554105436901], duration=15)
    problem.costs = [saltus.terminal([20, None])]
    published = saltus.loss_and_gradient(problem)
    assert_allclose(published.loss, 0.3995468507, rtol=1e-9)
    problem.parameters = [9.8, 0.98]
    run = saltus.solve(problem, solver="ceres_lm", optimize=["e"], bounds={"e": (0.75, 1)}, iterations=100)
    assert run.termination == "converged"
    assert_allclose(run.parameters[1], 0.988008392024876511903389, rtol=1e-12)
    assert run.loss < 1e-18
    assert len(run.events) == 2


@pytest.mark.parametrize("solver", ["mode_search", "ceres_phases", "ipopt", "ceres_lm", "gd"])
def test_no_iterations(solver):
    problem = saltus.HybridProblem(ball(), mode="flight", initial=[4, 0], parameters=[9.8, 0.7], duration=1.0,
                                   control=np.zeros((5, 1)))
    problem.costs = [saltus.terminal([1, 0], weight=100), saltus.effort(1 / 32)]
    run = saltus.solve(problem, solver=solver, iterations=0)
    assert run.termination != "converged"
    assert run.reason == "" or run.reason[0].isalnum() or run.reason[0] == "'", run.reason


def test_phases_of_free_duration():
    """The ball of hybrid iLQR: 2.195888610303352 in continuous time, at least 2.197662650662964 on 50 equal intervals."""
    problem = saltus.HybridProblem(ball(), mode="flight", initial=[4, 0], parameters=[9.8, 0.7], duration=1.0,
                                   control=np.zeros((50, 1)))
    problem.costs = [saltus.terminal([1, 0], weight=100), saltus.effort(1 / 32)]
    run = saltus.solve(problem, solver="ceres_phases", optimize=["control"])
    assert run.termination == "converged"
    assert 2.195888610303352 < run.loss < 2.197662650662964
    assert run.control.shape == (50, 1) and run.durations.shape == (50,)
    assert_allclose(run.durations.sum(), 1, rtol=1e-12)
    assert np.ptp(run.durations) > 1e-4
    assert [event[2] for event in run.events] == ["ground"]
    assert_allclose(run.events[0][0], 0.697936180950424916, atol=1e-3)
    assert run.certificate.verdict == "stationary"


def test_every_function_has_its_derivative():
    """Values and derivatives of what may be called, against differences of the same function of numbers."""
    functions = {
        "arithmetic": lambda x, y: (x + 2) * (3 - y) / (x * y) - -x + 2 / y - (5 - x) + abs(x - y),
        "powers": lambda x, y: x**2 + x**-1 + y**0.5 + x**y + 2.0**x + y**5,
        "remainder": lambda x, y: x % 0.37 + y // 0.23,
        "math": lambda x, y: (math.sin(x) * math.cos(y) + math.tan(x) + math.asin(x / 3) + math.acos(y / 3) + math.atan(x)
                              + math.atan2(y, x) + math.sinh(x) + math.cosh(y) + math.tanh(x) + math.asinh(x)
                              + math.acosh(1 + y) + math.atanh(x / 3) + math.exp(-x) + math.expm1(x) + math.log(y)
                              + math.log(y, 3) + math.log2(x) + math.log10(y) + math.log1p(x) + math.sqrt(y)
                              + math.hypot(x, y) + math.pow(x, y) + math.fabs(-x) + math.erf(x) + math.degrees(x)
                              + math.radians(y) + math.copysign(x, -y) + math.floor(x) + math.ceil(y)),
        "numpy": lambda x, y: (np.sin(x) + np.arctan2(x, y) + np.square(y) + np.maximum(x, y) + np.minimum(x, 0.5) + np.sign(x)
                               + np.hypot(x, y) + np.power(x, y) + np.cbrt(y) + np.exp(x) + np.log10(y) + np.arcsinh(x)
                               + np.float64(2) * x + np.clip(x, 0.1, 0.6)),
        "arrays": lambda x, y: np.array([x, y]) @ np.array([[1.0, 2], [3, 4]]) @ np.sin(np.array([x, y])) + np.linalg.norm([x, y]),
        "where": lambda x, y: saltus.where((x > y) & ~(y > 2) | (x < -1), x * y, math.exp(x) - y),
    }
    for name, f in functions.items():
        for at in ([0.7, 1.1], [1.3, 0.9]):
            system = saltus.HybridSystem(states={"m": ["x", "y"]}, flow={"m": lambda t, x, u, p: [0, 0]})
            problem = saltus.HybridProblem(system, mode="m", initial=at, duration=1.0)
            problem.costs = [saltus.residuals(lambda x, g=f: [1e-3 * g(x[0], x[1])], at="steps")]
            found = saltus.loss_and_gradient(problem)

            def loss(x, y):
                return (1e-3 * f(x, y)) ** 2

            assert_allclose(found.loss, loss(*at), rtol=1e-13, err_msg=name)
            w = 1e-4
            difference = [(8 * (loss(at[0] + w * i, at[1] + w * j) - loss(at[0] - w * i, at[1] - w * j))
                           - (loss(at[0] + 2 * w * i, at[1] + 2 * w * j) - loss(at[0] - 2 * w * i, at[1] - 2 * w * j))) / (12 * w)
                          for i, j in ((1, 0), (0, 1))]
            assert_allclose(found.gradient.initial, difference, rtol=1e-8, atol=1e-14, err_msg=name)


@pytest.mark.parametrize("flow", [
    lambda t, x, u, p: [x[1], -p[0] if x[0] > 0 else 0],
    lambda t, x, u, p: [x[1], max(-p[0], x[0])],
    lambda t, x, u, p: [x[1], x[0] and x[1]],
])
def test_branching_on_a_value_raises(flow):
    with pytest.raises(TypeError, match="flow of mode 'flight': .*saltus.where"):
        ball(flow={"flight": flow})


def test_turning_a_symbol_into_a_number_raises():
    with pytest.raises(TypeError, match="flow of mode 'flight': .*turns a symbol into a number"):
        ball(flow={"flight": lambda t, x, u, p: [x[1], float(x[0])]})
    assert math.sin is type(math).__dict__.get("sin", math.sin) and math.sin(0.5) == pytest.approx(np.sin(0.5))


@pytest.mark.parametrize("changes, kind, message", [
    ({"flow": {}}, ValueError, "flow: found none of mode 'flight'"),
    ({"flow": {"flight": lambda t, x, u, p: [x[1]]}}, ValueError, "flow of mode 'flight': found 1 numbers, expected 2"),
    ({"flow": {"flight": lambda t, x, u, p: [x[1], "a"]}}, TypeError, "flow of mode 'flight': found str"),
    ({"flow": {"flight": lambda t, x, u, p: [x[1], x[5]]}}, RuntimeError, "flow of mode 'flight': IndexError"),
    ({"guards": {"flight": {"ground": lambda t, x, p: x}}}, ValueError, "guard 'ground' of mode 'flight': found 2 numbers, expected 1"),
    ({"guards": {"flight": {}}}, ValueError, "mode 'flight': found 'ground' only in one of guards and resets"),
    ({"guards": {"sky": {}}}, ValueError, "guards: found mode 'sky'"),
    ({"resets": {"flight": {"ground": lambda t, x, p: ("sky", x)}}}, ValueError, "reset 'ground' of mode 'flight': found mode 'sky'"),
    ({"resets": {"flight": {"ground": lambda t, x, p: x}}}, ValueError, "reset 'ground' of mode 'flight': .*next mode's name"),
    ({"resets": {"flight": {"ground": lambda t, x, p: 1 / 0}}}, RuntimeError, "reset 'ground' of mode 'flight': ZeroDivisionError"),
    ({"states": {"flight": ["y", "y"]}}, ValueError, "states of mode 'flight': found 'y' twice"),
])
def test_bad_systems(changes, kind, message):
    with pytest.raises(kind, match=message):
        ball(**changes)


@pytest.mark.parametrize("changes, kind, message", [
    ({"mode": "sky"}, ValueError, "mode: found 'sky'"),
    ({"initial": [1]}, ValueError, "initial: found shape"),
    ({"parameters": [1, np.nan]}, ValueError, "parameters"),
    ({"control": np.zeros((4, 2))}, ValueError, "control"),
    ({"duration": -1.0}, ValueError, "duration"),
    ({"initial": [-1, 0]}, None, "guard 'ground'.*mode 'flight'"),
    ({"initial": [1, 0], "parameters": [9.8, 0.5]}, None, "accumulate .* at about t = 1.355"),
])
def test_bad_problems(changes, kind, message):
    with pytest.raises(kind or RuntimeError, match=message):
        saltus.rollout(ball_problem(**changes))


def test_bad_numbers_are_reported_with_mode_and_time():
    system = ball(flow={"flight": lambda t, x, u, p: [x[1], math.log(0.5 - t)]})
    problem = saltus.HybridProblem(system, mode="flight", initial=[10, 0], parameters=[9.81, 0.8], duration=2.0)
    with pytest.raises(RuntimeError, match="mode 'flight'.*t = "):
        saltus.rollout(problem)


def semi_implicit(mode, x, u, p, h):
    """Euler, and the reset at the end of the step that ends below the ground."""
    v = x[1] + h * (u[0] - p[0])
    y = x[0] + h * v
    return (mode, [0.0, -p[1] * v]) if y < 0 and v < 0 else (mode, [y, v])


def located(mode, x, u, p, h):
    """Exact flight, with the time of the impact within the step."""
    y, v, a = x[0], x[1], u[0] - p[0]
    end = y + v * h + a * h * h / 2
    if end >= 0 or a >= 0:
        return mode, [end, v + a * h]
    s = (-v - math.sqrt(v * v - 2 * a * y)) / a
    rest, w = h - s, -p[1] * (v + a * s)
    return mode, [w * rest + a * rest * rest / 2, w + a * rest]


def test_audit_of_a_scheme():
    problem = ball_problem(costs=[saltus.terminal([1, 0])])
    wrong = saltus.audit(problem, step=semi_implicit, steps=40, name="euler")
    assert wrong.verdict in ("wrong", "wrong sign")
    assert wrong.first_wrong.guard == "ground"
    assert wrong.first_wrong.step == int(0.55720308415835660801 / (2 / 40))
    assert "first wrong step is 11" in wrong.reason
    with pytest.raises(saltus.WrongGradient, match="euler"):
        wrong.raise_if_wrong()
    right = saltus.audit(problem, step=located, steps=40)
    assert right.verdict == "right"
    right.raise_if_wrong()


def test_an_audit_whose_steps_are_too_few_asks_for_more():
    """The error of explicit Euler steps on a spring grows as exp(50 h)."""
    spring = saltus.HybridSystem(states={"m": ["y", "v"]}, flow={"m": lambda x: [x[1], -10 - 100 * x[0]]})
    problem = saltus.HybridProblem(spring, mode="m", initial=[1, 0], duration=1, costs=[saltus.terminal([1, 0])])
    found = saltus.audit(problem, step=lambda mode, x, h: (mode, [x[0] + h * x[1], x[1] - h * (10 + 100 * x[0])]), steps=4)
    assert found.verdict == "unknown"
    assert found.reason == "the error falls, but not yet below one percent: begin with more steps"


def test_a_step_that_raises_ends_the_audit():
    def step(mode, x, u, p, h):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        saltus.audit(ball_problem(costs=[saltus.terminal([1, 0])]), step=step)


def test_track():
    # Exact values: the exponential of the Hamiltonian matrix, with 84 digits.
    drop = ball_problem(initial=[4, 0], parameters=[9.8, 0.7], duration=1.0, control=np.zeros((20, 1)))
    weights = {"Q": np.diag([1, 0.1]), "R": [[0.05]], "QT": np.diag([20, 5])}
    regulator = saltus.track(drop, **weights)
    assert_allclose(regulator.gains[18], [[5.300930898806861, -2.221581020167541]], rtol=1e-10)
    assert_allclose(regulator.cost_to_go[0], [[17.985378351607516, 5.6676179259690914], [5.6676179259690914, 3.732009620778854]],
                    rtol=1e-10)
    errors = 1e-4 * np.eye(2)
    assert_allclose(saltus.propagate(drop, errors).covariances[-1],
                    [[0.0000556041806150642175, -0.000151144593365937279], [-0.000151144593365937279, 0.000454025]], rtol=1e-10)
    closed = saltus.propagate(drop, errors, regulator=regulator)
    assert_allclose(closed.covariances[20], [[8.0271828309788786e-7, -4.1792147402346302e-6],
                                             [-4.1792147402346302e-6, 3.8770574513935986e-5]], rtol=1e-10)
    assert closed.warning == "" and len(closed.event_times) == 1
    continuous = saltus.track(drop, **weights, continuous=True)
    assert_allclose(continuous.events[0].saltation, [[-0.7, 0], [1.8815552078001857, -0.7]], rtol=1e-12)
    # The same with other intervals.
    assert_allclose(
        saltus.track(ball_problem(initial=[4, 0], parameters=[9.8, 0.7], duration=1.0, control=np.zeros((7, 1))),
                     **weights, continuous=True).cost_to_go[0],
        continuous.cost_to_go[0], rtol=1e-10)

    with pytest.raises(ValueError, match="R: .*positive definite"):
        saltus.track(drop, Q=np.eye(2), R=[[0.0]], QT=np.eye(2))
    with pytest.raises(ValueError, match="QT: found a matrix of 3 x 3, expected 2 x 2"):
        saltus.track(drop, Q=np.eye(2), R=[[1.0]], QT=np.eye(3))
    with pytest.raises(ValueError, match="covariance of the process: .*positive semidefinite"):
        saltus.propagate(drop, process=-np.eye(2))
    with pytest.raises(ValueError, match="continuous time"):
        saltus.propagate(drop, errors, regulator=continuous)
    # The runs have the covariance to first order, within four standard errors of its entries.
    runs = saltus.noisy_runs(drop, errors, regulator=regulator, samples=400)
    expected = closed.covariances[20]
    error = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / 400)
    assert (abs(runs.covariance - expected) < 4 * error).all()
    assert (runs.counted, runs.failed, runs.otherwise) == (400, 0, 0)


def test_feedback_of_a_scene():
    # The height of a disc is that of the ball; the other direction has no part in it.
    scene = saltus.Scene(
        name="ball", duration=1.0, steps=20, optimize="control", gravity=[0, -9.8],
        bodies=[{"name": "ball", "radius": 0.1, "mass": 1, "position": [0, 4.1]}],
        planes=[{"name": "ground", "point": [0, 0], "normal": [0, 1]}], contact={"restitution": 0.7},
        control={"bodies": ["ball"], "initial": [[0, 0]]},
        objective={"terminal": [{"body": "ball", "quantity": "position", "target": [0, 1], "weight": 1}], "effort": 0.1},
    )
    drop = ball_problem(initial=[4, 0], parameters=[9.8, 0.7], duration=1.0, control=np.zeros((20, 1)))
    of_ball = saltus.track(drop, Q=np.diag([1, 0.1]), R=[[0.05]], QT=np.diag([20, 5]))
    regulator = saltus.track(scene, Q=np.diag([1, 1, 0.1, 0.1]), R=0.05 * np.eye(2), QT=np.diag([20, 20, 5, 5]))
    for of_disc, of_height in zip(regulator.gains, of_ball.gains):
        assert_allclose(of_disc[1, [1, 3]], of_height[0], rtol=1e-9)
    errors = 1e-4 * np.eye(4)
    closed = saltus.propagate(scene, errors, regulator=regulator).covariances[-1]
    of_height = saltus.propagate(drop, errors[:2, :2], regulator=of_ball).covariances[-1]
    assert_allclose(closed[np.ix_([1, 3], [1, 3])], of_height, rtol=1e-8)
    # A plan of its own, in another model, whose positions follow the velocities at the ends of steps.
    plan = np.tile([[0.5, 0.0]], (20, 1, 1))
    runs = saltus.noisy_runs(scene, 1e-6 * np.eye(4), plan=plan, contact="toi_velocity", samples=50)
    assert runs.counted == 50 and abs(runs.mean[0] - 0.5 * 0.05**2 * 20 * 21 / 2) < 1e-3
    with pytest.raises(ValueError, match="R: found a matrix of 1 x 1, expected 2 x 2"):
        saltus.track(scene, Q=np.eye(4), R=[[1.0]], QT=np.eye(4))
    with pytest.raises(ValueError, match="plan"):
        saltus.propagate(scene, errors, plan=np.zeros((3, 1, 2)))
    with pytest.raises(ValueError, match="HybridProblem"):
        saltus.track(scene, Q=np.eye(4), R=np.eye(2), QT=np.eye(4), continuous=True)


def test_filter():
    # Exact values: prediction and update of the falling ball, by hand; the disc has the same.
    ball = ball_problem(initial=[1, 0], parameters=[9.8, 0.7], duration=1.0, control=np.zeros((1, 1))).system
    disc = {"name": "ball", "duration": 1, "steps": 1, "gravity": [0, -9.8], "contact": {"restitution": 0.7},
            "bodies": [{"name": "ball", "radius": 0.1, "mass": 1, "position": [0, 4]}],
            "planes": [{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
            "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [0, 1], "weight": 1}]},
            "optimize": "velocity"}
    P = np.diag([0.01, 0.04])
    filters = [
        (saltus.SaltedKalmanFilter(ball, [1, 0], P, parameters=[9.8, 0.7]), [0, 1], 0),
        (saltus.SaltedKalmanFilter(disc, [0, 1.1, 0, 0], np.diag([1, 0.01, 1, 0.04])), [1, 3], 0.1),
    ]
    for estimate, (y, v), ground in filters:
        estimate.predict(0.1)
        assert_allclose(estimate.mean[[y, v]], [0.951 + ground, -0.98], rtol=1e-10)
        C = np.eye(len(estimate.mean))[[y]]
        before = estimate.covariance[y, y]
        assert_allclose(before, 0.01 + 0.01 * 0.04, rtol=1e-10)
        estimate.update([1.02 + ground], C, [[0.0025]])
        assert_allclose(estimate.mean[y], 0.951 + ground + before / (before + 0.0025) * 0.069, rtol=1e-10)
        estimate.predict(0.6)  # past the impact
        assert estimate.mean[v] > 0 and estimate.time == 0.6
        with pytest.raises(ValueError, match="time"):
            estimate.predict(0.5)
    assert filters[0][0].mode == "flight" and filters[1][0].mode == ""
    with pytest.raises(ValueError, match="mean: found shape"):
        saltus.SaltedKalmanFilter(disc, [0, 1], P)


def test_states_may_be_guessed_where_the_control_has_no_motion():
    flow = {"m": lambda t, x, u, p: [x[1], x[0] ** 3 + u[0]]}
    line = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], flow=flow)
    problem = saltus.HybridProblem(line, mode="m", initial=[2, 0], duration=2.0, control=np.zeros((20, 1)))
    problem.costs = [saltus.effort(1), saltus.residuals(lambda x: [x[0], x[1]], role="equality")]
    states = [[2 - i / 5, -1] for i in range(11)]
    run = saltus.solve(problem, guess_states=states)
    assert run.termination == "converged", run.reason
    assert np.abs(run.final).max() < 1e-8
    with pytest.raises(ValueError, match="guess_states: found an array of shape"):
        saltus.solve(problem, guess_states=states[:1])
    with pytest.raises(ValueError, match="guess_states is for a HybridProblem"):
        saltus.solve({"name": "none"}, guess_states=states)


def test_modes_of_accumulations_that_lead_to_such_events_again_are_named():
    system = saltus.HybridSystem(
        states={"m": ["y", "v"]}, flow={"m": lambda x: [x[1], -9.8]}, guards={"m": {"ground": lambda x: x[0]}},
        resets={"m": {"ground": lambda x: ("m", [0 * x[0], -0.5 * x[1]])}}, on_accumulation={"m": {"ground": "m"}})
    problem = saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1.0)
    with pytest.raises(RuntimeError, match="lead to such events again"):
        saltus.rollout(problem)
