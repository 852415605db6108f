"""Numbers that are not finite, mistakes in functions, and steps that do not suffice: none is passed on in silence."""

import math
import re

import numpy as np
import pytest
from conftest import problem_of
from numpy.testing import assert_allclose

import saltus

# ------------------------------------------------------------------------------------------- derivatives that are none
#
# Motions of two states whose values are finite everywhere and whose derivatives are not at one place. Each kind names
# the function, the time and the variable of its message.

DERIVATIVES = {
    "hypot at rest": (dict(flow=lambda t, x, u, p: [x[1], -np.hypot(x[0], x[1])]), [0, 0], "the flow in mode 'm' at t = 0 .*by y"),
    "square root of a state": (dict(flow=lambda t, x, u, p: [np.sqrt(x[0]), u[0]]), [0, 0], "the flow in mode 'm' at t = 0 .*of y by y"),
    "power of a state": (dict(flow=lambda t, x, u, p: [x[1], x[0] ** 0.3]), [0, 0], "the flow in mode 'm' at t = 0 .*of v by y"),
    "root of a parameter": (dict(flow=lambda t, x, u, p: [x[1], np.sqrt(p[0]) + u[0]]), [0, 0], "the flow in mode 'm' at t = 0 .*of v by c"),
    "root of the control": (dict(flow=lambda t, x, u, p: [x[1], np.sqrt(u[0])]), [0, 0], "the flow in mode 'm' at t = 0 .*of v by f"),
    "arc cosine at its end": (dict(flow=lambda t, x, u, p: [0, np.arccos(x[0])]), [1, 0.5], "the flow in mode 'm' at t = 0 .*of v by y"),
    "0 times infinity": (dict(flow=lambda t, x, u, p: [0, x[0] * np.sqrt(x[0])]), [0, 0], "the flow in mode 'm' at t = 0 .*of v by y"),
    "reset by a root": (dict(guard=lambda t, x, p: 1 - x[0], reset=lambda t, x, p: ("m", [0, np.sqrt(p[0])])), [0, 2],
                        "the reset of guard 'g' in mode 'm' at t = 0.5 .*of v by c"),
    "guard by a root": (dict(guard=lambda t, x, p: 1 - x[0] + np.sqrt(p[0]), reset=lambda t, x, p: ("m", [0, x[1]])), [0, 2],
                        "the guard 'g' in mode 'm' at t = 0.5 .*by c"),
}
COSTS = {
    "cost by a root": (lambda x: [np.sqrt(x[0])], "end", "c0: the function has no finite derivative at t = 1 in mode 'm'"),
    "cost of the parameter": (lambda x, p: [x[0] - np.sqrt(p[0])], "end", "c0: the function has no finite derivative at t = 1"),
    "cost at steps": (lambda x, u: [np.hypot(u[0], 0 * x[0])], "steps", "c0: the function has no finite derivative at t = 0"),
}


def with_derivative(name):
    if name in DERIVATIVES:
        functions, initial, message = DERIVATIVES[name]
        return problem_of(**functions, initial=initial), message
    function, at, message = COSTS[name]
    return problem_of(costs=[saltus.residuals(function, at=at, name="c0")]), message


EVERYTHING = ["control", "initial", "parameters"]


def solve_with(solver):
    def call(problem):
        run = saltus.solve(problem, solver=solver, optimize=EVERYTHING, iterations=20)
        assert run.termination == "failed", (run.termination, run.reason)
        assert run.certificate is None or run.certificate.verdict == "not_applicable"
        raise RuntimeError(run.reason)

    return call


def final_derivatives(problem):
    found = saltus.final_derivatives(problem)
    assert not all(np.all(np.isfinite(by)) for by in (found.by_initial, found.by_control, found.by_parameters, found.by_duration))
    raise RuntimeError(found.remark)


def run_filter(problem):
    filter_ = saltus.SaltedKalmanFilter(problem.system, problem.initial, np.eye(2), parameters=[0.0])
    filter_.predict(1.0)


def audit(problem):
    found = saltus.audit(problem, step=lambda mode, x, u, p, h: (mode, x), steps=4)
    assert found.verdict not in ("right", "consistent", "wrong")
    raise RuntimeError(found.reason)


OF_STATES = {
    "propagate": lambda problem: saltus.propagate(problem, np.eye(2)),
    "track": lambda problem: saltus.track(problem, np.eye(2), np.eye(1), np.eye(2)),
    "noisy runs": lambda problem: saltus.noisy_runs(problem, np.eye(2) * 1e-6, samples=10),
    "filter": run_filter,
}
OF_ALL = {
    "loss and gradient": saltus.loss_and_gradient,
    "audit": audit,
    **{solver: solve_with(solver) for solver in ("gd", "ceres_lbfgs", "ceres_lm", "ceres_phases", "mode_search")},
}


@pytest.mark.parametrize("name", [*DERIVATIVES, *COSTS])
def test_no_verdict_from_a_derivative_that_is_none(name, capfd):
    problem, message = with_derivative(name)
    calls = dict(OF_ALL)
    if name in DERIVATIVES:
        calls["final derivatives"] = final_derivatives
        if " by c" not in message and " by f" not in message:
            calls |= OF_STATES
    del calls["mode_search"]  # whose other starts have derivatives
    for what, call in calls.items():
        with pytest.raises(RuntimeError) as caught:
            call(problem)
        assert re.search(message, str(caught.value)), (what, str(caught.value))
    assert len(capfd.readouterr().err) < 200


def test_a_loss_of_zero_needs_no_derivative():
    """A sum of squares is not less than zero, whatever its derivatives."""
    problem = problem_of(flow=lambda t, x, u, p: [0, np.arccos(x[0])], initial=[1, 0])
    run = saltus.solve(problem, solver="ceres_phases", optimize=EVERYTHING)
    assert run.loss == 0 and run.iterations == 0
    assert run.termination == "converged" and run.certificate.verdict == "global"


def test_what_is_not_asked_for_may_have_no_derivative():
    """The flow has an infinite derivative by the parameter and by the time at the start; those by states are exact."""
    flow = lambda t, x, u, p: [x[1], np.sqrt(p[0]) + np.sqrt(t) + u[0]]  # noqa: E731
    with pytest.raises(RuntimeError, match="by a factor of 2.8, .* not smooth in mode .m. at t = 0,"):  # h^1.5
        saltus.rollout(problem_of(flow=flow))
    problem = problem_of(flow=flow, tolerance=1e-7)
    assert_allclose(saltus.rollout(problem).final, [4 / 15, 2 / 3], rtol=1e-7)
    found = saltus.final_derivatives(problem)
    assert_allclose(found.by_initial, [[1, 1], [0, 1]], atol=1e-12)
    assert not np.any(np.isfinite(found.by_parameters))
    assert re.search(r"no finite derivative of v by [tc]$", found.remark)  # either has none
    assert_allclose(saltus.propagate(problem, np.eye(2)).covariances[-1], [[2, 1], [1, 1]], atol=1e-12)
    run = saltus.solve(problem, solver="ceres_lm")
    assert run.termination == "converged" and run.loss < 1e-20


def dropped(drag):
    """A ball dropped with quadratic drag c, which is to be found: y(1) = 10 - log(cosh(sqrt(9.81 c))) / c."""
    fall = saltus.HybridSystem(
        states={"m": ["x", "y", "vx", "vy"]}, parameters=["c"],
        flow={"m": lambda t, x, u, p: [x[2], x[3], -drag(p[0], x[2], x[3])[0], -9.81 - drag(p[0], x[2], x[3])[1]]})
    problem = saltus.HybridProblem(fall, mode="m", initial=[0, 10, 0, 0], parameters=[0.1], duration=1.0)
    problem.costs = [saltus.terminal([None, 5.9, None, None])]
    return problem


def product_of_norm(c, v, w):
    return c * v * np.linalg.norm([v, w]), c * w * np.linalg.norm([v, w])


DRAGS = {
    "hypot": lambda c, v, w: (c * np.hypot(v, w) * v, c * np.hypot(v, w) * w),
    "norm": product_of_norm,
    "root of squares, factor first": lambda c, v, w: (v * c * (v * v + w * w) ** 0.5, w * (c * np.sqrt(v * v + w * w))),
    "quotient": lambda c, v, w: (v / (1 / (c + 1) + np.hypot(v, w)) * (np.hypot(v, w) / (c + 1) + np.hypot(v, w) ** 2) * c,
                                 w / (1 / (c + 1) + np.hypot(v, w)) * (np.hypot(v, w) / (c + 1) + np.hypot(v, w) ** 2) * c),
}


@pytest.mark.parametrize("drag", DRAGS)
def test_a_product_with_a_factor_of_zero_needs_no_derivative_of_the_other_one(drag):
    """v hypot(v, w) has the derivative zero at rest, where hypot has none."""
    problem = dropped(DRAGS[drag])
    found = saltus.final_derivatives(problem)
    assert found.remark == ""
    rate = math.sqrt(9.81 * 0.1)
    assert_allclose(found.by_parameters.ravel()[:2], [0, 5.136784684775591], rtol=1e-9, atol=1e-12)
    assert_allclose(found.by_initial, [[1, 0, math.atan(math.sinh(rate)) / rate, 0], [0, 1, 0, math.tanh(rate) / rate],
                                       [0, 0, 1 / math.cosh(rate), 0], [0, 0, 0, 1 / math.cosh(rate) ** 2]], rtol=1e-9, atol=1e-12)
    for solver in ("ceres_phases", "ceres_lm", "ceres_lbfgs", "gd"):
        run = saltus.solve(problem, solver=solver, optimize=["c"])
        assert run.termination == "converged"
        assert_allclose(run.parameters, [0.134273062159674], rtol=1e-6)


def test_products_of_roots_keep_their_derivatives():
    """sqrt(y) sqrt(y) is y, and sqrt(y) hypot(y, v) has no derivative by y at zero: none of these is called zero."""
    by_y = (lambda x: [np.sqrt(x[0]) * np.sqrt(x[0]), 0], "of y by y")
    by_v = (lambda x: [0, np.sqrt(x[0]) * np.hypot(x[0], x[1])], "of v by y")
    for flow, text in (by_y, by_v):
        found = saltus.final_derivatives(problem_of(flow=flow, initial=[0, 0], costs=[]))
        assert text in found.remark


# ------------------------------------------------------------------------------------------------ values that are none

VALUES = {
    "root of time": (dict(flow=lambda t, x, u, p: [x[1], np.sqrt(0.5 - t)]), "the flow of mode 'm' at t = 0.5.* gives no finite derivative of v"),
    "logarithm": (dict(flow=lambda t, x, u, p: [-1, np.log(x[0])], initial=[0.5, 0]), "the flow of mode 'm' at t = 0.5.* of v"),
    "at the start": (dict(flow=lambda t, x, u, p: [x[1], np.sqrt(p[0] - 1)]), "the flow of mode 'm' at t = 0 gives no finite derivative of v"),
    "division by zero": (dict(flow=lambda t, x, u, p: [x[1] / p[0], 0]), "the flow of mode 'm' at t = 0 gives no finite derivative of y"),
    "infinity times zero": (dict(flow=lambda t, x, u, p: [x[1] * np.exp(1e4 * t), 0]), "the flow of mode 'm' at t = 0.0.* of y"),
    "guard": (dict(guard=lambda t, x, p: 1 + np.sqrt(0.3 - t), reset=lambda t, x, p: ("m", x)), "guard 'g' is not a finite number in mode 'm'"),
    "reset": (dict(guard=lambda t, x, p: 0.5 - t, reset=lambda t, x, p: ("m", [np.log(-1 - x[0] * x[0]), 0])),
              "the reset of guard 'g' in mode 'm' at t = 0.5 gives no finite y"),
}


@pytest.mark.parametrize("name", VALUES)
def test_values_that_are_none_are_named(name):
    changes, message = VALUES[name]
    problem = problem_of(**changes)
    for call in (saltus.rollout, saltus.final_derivatives, *OF_STATES.values(), *OF_ALL.values()):
        with pytest.raises(RuntimeError) as caught:
            call(problem)
        assert re.search(message, str(caught.value)), str(caught.value)
        assert "stiff" not in str(caught.value)


def test_a_motion_without_a_solution_is_not_called_stiff():
    """y' = y^2 from 2 grows beyond all bounds at t = 0.5."""
    problem = problem_of(flow=lambda t, x, u, p: [x[0] ** 2, 0], initial=[2, 0])
    with pytest.raises(RuntimeError, match=r"mode 'm' at t = 0\.(5000|4999).*(y overflows|no finite derivative of y).*there is no solution after that") as caught:
        saltus.rollout(problem)
    assert "stiff" not in str(caught.value)


def test_a_cost_that_is_none_is_named():
    problem = problem_of(costs=[saltus.residuals(lambda x, t: [np.log(x[0] - t)], at="steps", name="barrier")])
    for call in OF_ALL.values():
        with pytest.raises(RuntimeError, match="barrier: the function has no finite value at t = 0 in mode 'm'"):
            call(problem)


# -------------------------------------------------------------------------------------------------------------- limits

def bouncing(intervals):
    ball = saltus.HybridSystem(
        states={"f": ["y", "v"]}, controls=["f"], parameters=["e"], flow={"f": lambda t, x, u, p: [x[1], -9.81 + u[0]]},
        guards={"f": {"g": lambda t, x, p: x[0]}}, resets={"f": {"g": lambda t, x, p: ("f", [0, -p[0] * x[1]])}})
    return saltus.HybridProblem(ball, mode="f", initial=[1, 0], parameters=[0.7], duration=1.6, control=np.zeros((intervals, 1)),
                                costs=[saltus.terminal([0.3, 0.0], weight=10), saltus.effort(0.1)])


@pytest.mark.parametrize("intervals", [1, 2])
def test_fewer_intervals_than_phases(intervals):
    """The ends of intervals stay, and events are within them. Single shooting from the solution finds nothing better."""
    problem = bouncing(intervals)
    run = saltus.solve(problem, solver="ceres_phases")
    assert run.termination == "converged" and len(run.events) >= intervals
    problem.start_from(run)
    shot = saltus.solve(problem, solver="ceres_lm")
    assert shot.termination == "converged" and abs(shot.loss - run.loss) <= 1e-8 * run.loss


@pytest.mark.parametrize("iterations", [0, 1, 2, 5, 17])
@pytest.mark.parametrize("solver", ["gd", "ceres_lbfgs", "ceres_lm", "ceres_phases"])
def test_iterations_are_obeyed(solver, iterations):
    run = saltus.solve(bouncing(12), solver=solver, iterations=iterations)
    assert run.iterations <= iterations and len(run.losses) == run.iterations + 1
    if run.termination == "iteration_limit":
        assert run.iterations == iterations
    if iterations <= 1:
        assert run.termination == "iteration_limit"
    assert_allclose(run.loss, loss_of(run), rtol=1e-6)


def loss_of(run):
    """The loss of a control on its intervals, by the closed form of a ball under forces that are held."""
    y, v, t, effort = 1.0, 0.0, 0.0, 0.0
    for u, length in zip(run.control[:, 0], run.durations):
        effort += 0.1 * u * u * length
        left, a = length, u - 9.81
        while left > 0:
            if y < 1e-9 and v < 0:
                v = -0.7 * v
            roots = [s for s in np.roots([a / 2, v, y]) if abs(s.imag) < 1e-12 and 1e-9 < s.real < left]
            s = min((root.real for root in roots), default=left)
            y, v, left = y + v * s + a * s * s / 2, v + a * s, left - s
            if roots:
                y, v = 0.0, -0.7 * v
    return 10 * ((y - 0.3) ** 2 + v**2) + effort


@pytest.mark.parametrize("rate", [0.0, -0.01, math.nan, math.inf])
def test_rates_that_are_none(rate):
    with pytest.raises(ValueError, match="learning_rate: .*expected a finite number > 0"):
        saltus.solve(bouncing(12), solver="gd", learning_rate=rate)


def test_a_rate_below_rounding_has_not_converged():
    problem = bouncing(12)
    problem.control = np.ones((12, 1))
    run = saltus.solve(problem, solver="gd", learning_rate=1e-300, iterations=3)
    assert run.termination == "no_progress" and "learning rate" in run.reason


@pytest.mark.parametrize("changes", [
    {"tolerance": 0.0}, {"tolerance": math.inf}, {"tolerance": math.nan}, {"tolerance": -1.0}, {"steps_per_interval": -1},
    {"duration": 0.0}, {"duration": -1.0}, {"duration": math.inf}, {"duration": math.nan}, {"initial": [math.nan, 0]},
    {"parameters": [math.inf]}, {"control": [[math.nan]]}, {"control": np.zeros((0, 1))},
])
def test_options_of_a_problem_that_are_none(changes):
    with pytest.raises(ValueError):
        saltus.HybridProblem(problem_of().system, **{"mode": "m", "initial": [0, 0], "parameters": [0], "duration": 1.0, **changes})


# --------------------------------------------------------------------------------------------- enough integration steps

def oscillator(w, **changes):
    system = saltus.HybridSystem(states={"m": ["x", "v"]}, parameters=["w"], flow={"m": lambda t, x, u, p: [x[1], -p[0] ** 2 * x[0]]})
    return saltus.HybridProblem(system, mode="m", initial=[1, 0], parameters=[w], duration=2.0, **changes)


def test_a_gradient_has_enough_steps_whatever_came_before():
    """x = cos(w t); a problem is used for one frequency after the other."""
    problem = oscillator(1.0, costs=[saltus.terminal([0.0, None])])
    for w in (1.0, 60.0, 3.0, 200.0, 0.5, 600.0):
        problem.parameters = [w]
        found = saltus.loss_and_gradient(problem)
        assert_allclose(found.loss, math.cos(2 * w) ** 2, atol=1e-9)
        assert_allclose(found.gradient.parameters, [-2 * math.sin(4 * w)], atol=1e-7)


@pytest.mark.parametrize("solver", ["gd", "ceres_lm", "ceres_lbfgs", "ceres_phases"])
def test_a_solution_has_enough_steps(solver):
    """The solver moves a frequency from 3 to 60; the loss of what it returns is that of the exact motion there."""
    problem = oscillator(3.0, costs=[saltus.residuals(lambda p: [3 * (p[0] - 60)]), saltus.terminal([0.3, None])])
    run = saltus.solve(problem, solver=solver, optimize=["w"], iterations=200, learning_rate=0.02)
    w = run.parameters[0]
    assert_allclose(run.loss, 9 * (w - 60) ** 2 + (math.cos(2 * w) - 0.3) ** 2, rtol=1e-8, atol=1e-10)
    assert run.integration_error < 1e-10
    if run.termination == "converged":
        # 18 (w - 60) - 4 (cos 2w - 0.3) sin 2w = 0.
        assert abs(18 * (w - 60) - 4 * (math.cos(2 * w) - 0.3) * math.sin(2 * w)) < 1e-5
    assert run.iterations <= 200 and len(run.losses) == run.iterations + 1


@pytest.mark.parametrize("w", [200.0, 400.0])
def test_a_filter_has_enough_steps_in_every_prediction(w):
    """Predictions of equal length, the first in a slow mode: x = cos(w (t - 1.05)) behind t = 1.05."""
    system = saltus.HybridSystem(
        states={"slow": ["x", "v"], "fast": ["x", "v"]}, parameters=["w"],
        flow={"slow": lambda t, x, u, p: [1.0, 0.0], "fast": lambda t, x, u, p: [x[1], -p[0] ** 2 * x[0]]},
        guards={"slow": {"g": lambda t, x, p: 1.05 - x[0]}}, resets={"slow": {"g": lambda t, x, p: ("fast", [1.0, 0.0])}})
    found = saltus.SaltedKalmanFilter(system, [0, 0], np.eye(2) * 1e-6, mode="slow", parameters=[w])
    for k in range(1, 21):
        found.predict(0.1 * k)
    assert_allclose(found.mean, [math.cos(0.95 * w), -w * math.sin(0.95 * w)], rtol=1e-8)


def test_a_closed_form_is_compared_with_the_flow_with_given_steps_too():
    problem = oscillator(1.0)
    wrong = saltus.HybridSystem(
        states={"m": ["x", "v"]}, parameters=["w"], flow={"m": lambda t, x, u, p: [x[1], -p[0] ** 2 * x[0]]},
        fly={"m": lambda t, s, x, u, p: [x[0] + 2 * s * x[1], x[1]]})
    for steps in (0, 1, 40):
        fixed = saltus.HybridProblem(wrong, mode="m", initial=[1, 1], parameters=[1.0], duration=2.0, steps_per_interval=steps)
        with pytest.raises(RuntimeError, match="Fly is no closed form of the flow of mode 'm'"):
            saltus.rollout(fixed)
    assert saltus.rollout(problem).final[0] == pytest.approx(math.cos(2))


def test_a_pole_of_the_flow_is_no_jump():
    """A body falls into the centre of an attraction 1 / r^2 from rest at r = 1: at t = pi / sqrt(8)."""
    def flow(t, x, u, p):
        cube = np.hypot(x[0], x[1]) ** 3
        return [x[2], x[3], -x[0] / cube, -x[1] / cube]

    system = saltus.HybridSystem(states={"m": ["x", "y", "v", "w"]}, flow={"m": flow})
    with pytest.raises(RuntimeError, match=r"grows beyond all bounds at t = 1\.110.*there is no solution after that"):
        saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[1, 0, 0, 0], duration=2.0))


def test_a_stiff_flow_is_refused_with_what_to_do():
    def relaxation(rate):
        flow = {"m": lambda t, x, u, p: [-rate(p) * (x[0] - 1)]}
        return saltus.HybridProblem(saltus.HybridSystem(states={"m": ["x"]}, parameters=["k"], flow=flow),
                                    mode="m", initial=[0.5], parameters=[1e9], duration=2.0)

    assert_allclose(saltus.rollout(relaxation(lambda p: 1e9)).final, [1], rtol=1e-12)
    with pytest.raises(RuntimeError, match="stiff.*; lower its fastest rates, or .* with numbers in place of parameters"):
        saltus.rollout(relaxation(lambda p: p[0]))


def test_steps_that_are_too_long_for_a_flow_are_no_jump_of_it():
    system = saltus.HybridSystem(states={"m": ["x"]}, flow={"m": lambda t, x, u, p: [np.sin(1e5 * x[0] * x[0])]})
    with pytest.raises(RuntimeError, match="does not converge|may be stiff"):
        saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[1.0], duration=50.0))
