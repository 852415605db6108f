"""Terms of hybrid problems: regions, conditions, given times, start and end, data; and pages."""

import itertools
import json
import math
import pickle

import numpy as np
import pytest
from conftest import SOURCE
from numpy.testing import assert_allclose

import saltus


def integrator(states=1, **changes):
    """dx/dt = u, from x = 0 in 1 s: with an effort, the best control to a place is constant."""
    names = [f"x{i}" for i in range(states)]
    system = saltus.HybridSystem(states={"m": names}, controls=[f"u{i}" for i in range(states)], flow={"m": lambda x, u: u})
    given = {"mode": "m", "initial": np.zeros(states), "duration": 1.0, "control": np.full((8, states), 0.5), **changes}
    return saltus.HybridProblem(system, **{**given, "costs": [saltus.effort(), *given.get("costs", [])]})


def ball(**changes):
    system = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, parameters=["g", "e"], flow={"flight": lambda x, p: [x[1], -p[0]]},
        guards={"flight": {"ground": lambda x: x[0]}},
        resets={"flight": {"ground": lambda x, p: ("flight", [x[0], -p[1] * x[1]])}},
        draw=lambda x: [[-1, 0, 1, 0], [0, x[0] + 0.1, 0.1]])
    given = {"mode": "flight", "initial": [1.0, 0.0], "parameters": [9.81, 0.8], "duration": 1.5, **changes}
    return saltus.HybridProblem(system, **given)


def height(t, e, g=9.81, y0=1.0):
    """The closed form of the ball from rest, up to its second bounce."""
    falls = math.sqrt(2 * y0 / g)
    return y0 - g * t**2 / 2 if t <= falls else (t - falls) * (e * g * falls - g * (t - falls) / 2)


def check_gradient(problem, names=("initial", "parameters")):
    gradient = saltus.loss_and_gradient(problem).gradient
    for name in names:
        at = np.array(getattr(problem, name), dtype=float)
        for place in np.ndindex(at.shape):
            ends = []
            for step in (-1e-5, 1e-5):
                moved = at.copy()
                moved[place] += step
                setattr(problem, name, moved)
                ends.append(saltus.loss_and_gradient(problem).loss)
            setattr(problem, name, at)
            found = np.asarray(gradient[name])[place]
            assert abs((ends[1] - ends[0]) / 2e-5 - found) < 1e-6 * max(1, abs(found)), (name, place)


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt"])
def test_a_goal_region_is_reached_at_its_edge(solver):
    if solver not in saltus.hybrid_solvers():
        pytest.skip(f"{solver} is not built")
    problem = integrator(2, costs=[saltus.terminal(min=[2, None], max=[3, -1])])
    run = saltus.solve(problem, solver=solver)
    assert_allclose(run.final, [2, -1], rtol=0, atol=1e-6)
    assert_allclose(run.loss, 5, rtol=1e-6)
    assert run.certificate["verdict"] == "stationary"


def test_the_largest_value_is_reached_at_the_bounds():
    """From x = 0 with |u| <= 1 the farthest place after 1 s is x = 1, less the effort, which is the mean of u^2."""
    bounds = {"u0": (-1, 1), "u1": (-1, 1)}
    for function in (lambda x: 3 * x[0] - 4 * x[1], lambda t, x: [3 * x[0], -4 * x[1]]):
        run = saltus.solve(integrator(2, costs=[saltus.maximise(function)]), bounds=bounds)
        assert run.termination == "converged"
        assert_allclose(run.loss, -7 + 2, rtol=1e-7)
        assert_allclose(run.final, [1, -1], atol=1e-6)


def test_a_region_that_holds_the_free_motion_changes_nothing():
    run = saltus.solve(integrator(costs=[saltus.terminal(min=[-1], max=[1])]), solver="ceres_phases")
    assert abs(run.final[0]) < 1e-4 and run.loss < 1e-8


def test_a_hard_component_is_met_and_the_others_are_free():
    run = saltus.solve(integrator(2, costs=[saltus.terminal([2.0, None], hard=True)]), solver="ceres_phases")
    assert_allclose(run.final, [2, 0], rtol=0, atol=1e-7)
    assert_allclose(run.loss, 4, rtol=1e-7)


@pytest.mark.parametrize("changes, message", [
    ({}, "target: found none"),
    ({"min": [None]}, "min and max: found no finite number"),
    ({"min": [1], "max": [0]}, "min: found 1 above max"),
    ({"min": [1, 2], "max": [3]}, "min and max: found 2 and 1 numbers"),
    ({"target": [1], "min": [0]}, "min and max: found them beside a target"),
    ({"target": [1], "hard": True, "weight": 2}, "weight: found one of a hard target"),
])
def test_wrong_targets_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        saltus.terminal(**changes)


def test_terms_of_parameters_of_the_start_and_of_both_ends():
    terms = [saltus.residuals(lambda p: [p[1] - 0.3]), saltus.residuals(lambda x0: [x0[0] - 0.5, 2 * x0[1]]),
             saltus.residuals(lambda x0, xT, p: [xT[0] - p[1] * x0[0], xT[1] * x0[1]]), saltus.cost(lambda x0: x0[0] ** 3)]
    problem = ball(initial=[1.0, 0.2], costs=terms)
    y, v = saltus.rollout(problem).final
    expected = 0.5**2 + 0.5**2 + 0.4**2 + (y - 0.8) ** 2 + (0.2 * v) ** 2 + 1
    assert_allclose(saltus.loss_and_gradient(problem).loss, expected, rtol=1e-12)
    check_gradient(problem)


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt"])
def test_a_condition_links_start_and_end(solver):
    """The state grows by 1, from a start that is drawn to 5: u = 1, and the loss is the effort."""
    if solver not in saltus.hybrid_solvers():
        pytest.skip(f"{solver} is not built")
    problem = integrator(initial=[4.0], costs=[saltus.residuals(lambda x0: [x0[0] - 5]),
                                               saltus.residuals(lambda x0, xT: xT - x0 - 1, role="equality")])
    run = saltus.solve(problem, solver=solver, optimize=["control", "initial"])
    assert_allclose(run.initial, [5], rtol=1e-6)
    assert_allclose(np.ravel(run.control), 1, rtol=1e-6)
    assert_allclose(run.loss, 1, rtol=1e-6)
    assert run.certificate["verdict"] == "stationary"


def test_residuals_of_the_start_have_a_jacobian():
    """Levenberg-Marquardt finds the start and the restitution at once."""
    problem = ball(costs=[saltus.residuals(lambda x0: [x0[0] - 1.2]), saltus.residuals(lambda xT: [xT[0] - 0.3])])
    run = saltus.solve(problem, solver="ceres_lm", optimize=["y", "e"])
    assert run.loss < 1e-20
    assert_allclose([run.initial[0], run.final[0]], [1.2, 0.3], rtol=1e-8)


def test_values_at_given_times():
    times, targets = [0.2, 0.7], [0.5, 0.1]
    durations = [0.2, 0.5, 0.8]
    term = saltus.residuals(lambda x, t: [x[0] - t], at=times)
    problem = ball(durations=durations, control=np.zeros((3, 0)), costs=[term])
    expected = sum((height(t, 0.8) - t) ** 2 for t in times)
    assert_allclose(saltus.loss_and_gradient(problem).loss, expected, rtol=1e-12)
    check_gradient(problem)
    at_end = ball(costs=[saltus.residuals(lambda x: [x[0]], at=[0.0, 1.5])])
    assert_allclose(saltus.loss_and_gradient(at_end).loss, 1 + saltus.rollout(at_end).final[0] ** 2, rtol=1e-12)
    copied = pickle.loads(pickle.dumps(problem))
    assert saltus.loss_and_gradient(copied).loss == saltus.loss_and_gradient(problem).loss
    anywhere = ball(costs=[term])  # a system without controls has intervals that begin at the times
    assert anywhere.intervals == 3 and anywhere.durations is None
    assert_allclose(saltus.loss_and_gradient(anywhere).loss, expected, rtol=1e-12)
    with pytest.raises(ValueError, match=r"found the time 1.7, expected the beginning of a control interval or the end, such as 1.5"):
        ball(costs=[saltus.residuals(lambda x: x, at=[1.7])])
    driven = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda u: [u[0]]})
    with pytest.raises(ValueError, match=r"found the time 0.3, expected the beginning of a control interval or the end, such as 0.5"):
        saltus.HybridProblem(driven, mode="m", initial=[0], duration=1.0, control=[[1.0], [2.0]], costs=[saltus.residuals(lambda x: x, at=[0.3])])
    with pytest.raises(ValueError, match="optimize: found the duration, with which the times of 'cost at given times'"):
        saltus.solve(problem, optimize=["e", "duration"])
    by_steps, by_shooting = (saltus.solve(problem, solver=solver, optimize=["e"]) for solver in ("ceres_phases", "ceres_lm"))
    assert by_steps.termination == by_shooting.termination == "converged"
    assert_allclose([by_steps.loss, *by_steps.parameters], [by_shooting.loss, *by_shooting.parameters], rtol=1e-7)
    with pytest.raises(ValueError, match="at: found .*, expected a list of finite times"):
        saltus.residuals(lambda x: x, at=[-1.0])
    with pytest.raises(ValueError, match="only a term at the end reads the states x0"):
        ball(costs=[saltus.residuals(lambda x0: x0, at="steps")])


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt", "mode_search", "auto"])
def test_a_constraint_at_a_given_time(solver):
    """To be at 1 half-way, at least effort, takes a speed of 2 until then."""
    there = saltus.residuals(lambda x: [1 - x[0]], at=[0.5], role="inequality")
    run = saltus.solve(integrator(costs=[there]), solver=solver)
    assert (run.termination, run.certificate.verdict) == ("converged", "stationary_on_grid")
    half = len(run.control) // 2
    assert_allclose(np.ravel(run.control), [2.0] * half + [0.0] * half, atol=1e-7)
    assert_allclose(run.loss, 2, rtol=1e-7)


def test_a_constraint_at_a_given_time_is_one_at_an_event():
    """The clock as a guard. To be at 1 half-way, at least effort, takes a speed of 2 until then."""
    effort = saltus.effort()
    system = saltus.HybridSystem(
        states={"before": ["x"], "after": ["x"]}, controls=["u"], flow=dict.fromkeys(("before", "after"), lambda u: u),
        guards={"before": {"half-way": lambda t: 0.5 - t}}, resets={"before": {"half-way": lambda x: ("after", x)}})
    at_event = saltus.residuals(lambda x: [1 - x[0]], at="event", mode="before", guard="half-way", role="inequality")
    problem = saltus.HybridProblem(system, mode="before", initial=[0], duration=1.0, control=np.full((8, 1), 0.5),
                                   costs=[effort, at_event])
    run = saltus.solve(problem, solver="ceres_phases")
    assert run.termination == "converged" and abs(run.loss - 2) < 1e-6
    assert_allclose(run.events[0][0], 0.5, rtol=1e-9)


def test_restitution_from_measurements_some_of_which_are_missing():
    times = np.array([0.1, 0.3, 0.5, 0.6, 0.8, 1.0])
    heights = np.array([height(t, 0.65) for t in times])
    heights[2] = np.nan
    durations = np.diff([0.0, *times, 1.1])
    data = saltus.measurements(times, heights, ["y"], sigma=0.01)
    problem = ball(duration=1.1, durations=durations, control=np.zeros((7, 0)), costs=[data])
    expected = sum(((height(t, 0.8) - y) / 0.01) ** 2 for t, y in zip(times, heights) if np.isfinite(y))
    assert_allclose(saltus.loss_and_gradient(problem).loss, expected, rtol=1e-10)
    run = saltus.solve(problem, solver="ceres_lm", optimize=["e", "g"])
    assert_allclose(run.parameters, [9.81, 0.65], rtol=1e-8)
    copied = pickle.loads(pickle.dumps(problem))
    assert saltus.loss_and_gradient(copied).loss == saltus.loss_and_gradient(problem).loss
    both = saltus.measurements(times, np.column_stack([heights, 2 * heights]), lambda x: [x[0], 2 * x[0]], sigma=0.01)
    problem.costs = [both]
    assert_allclose(saltus.loss_and_gradient(problem).loss, 5 * expected, rtol=1e-10)


@pytest.mark.parametrize("arguments, message", [
    (([0.1], [[1, 2]], ["y"]), "states: found 1, expected 2"),
    (([0.1, 0.2], [1.0], ["y"]), r"values: found shape \(1,\), expected \(2, S\)"),
    (([0.1], [np.nan], ["y"]), "values: expected finite numbers, and NaN where one is missing"),
    (([0.1], [1.0], ["y", "y"]), "states: found 'y' twice"),
])
def test_wrong_measurements_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        saltus.measurements(*arguments)
    with pytest.raises(ValueError, match="sigma: expected finite numbers > 0"):
        saltus.measurements([0.1], [1.0], ["y"], sigma=0)
    with pytest.raises(ValueError, match="measurements: found state 'z', expected some of y, v"):
        ball(costs=[saltus.measurements([0.0], [1.0], ["z"])])
    with pytest.raises(ValueError, match=r"sigma: found shape \(2,\), expected one number, or \(3,\), one for each value"):
        saltus.measurements([0.1, 0.2, 0.3], np.ones(3), ["y"], sigma=[0.1, 0.2])
    for wrong in ([0.1, 0.2], np.ones((2, 2)), np.ones((3, 1))):  # the last one could be spread over the values, too
        with pytest.raises(ValueError, match=r"expected one number, or \(3, 3\), one for each value or \(3,\), one for each state"):
            saltus.measurements([0.1, 0.2, 0.3], np.ones((3, 3)), lambda x: [x[0]] * 3, sigma=wrong)


def test_the_deviations_of_measurements_are_those_of_values_or_states():
    times, values = [0.1, 0.3], np.array([[0.5, -1.0], [0.2, -2.0]])
    motion = [[height(t, 0.8), -9.81 * t] for t in times]
    by_state, by_value = np.array([0.1, 0.2]), np.array([[0.1, 0.2], [0.3, 0.4]])
    for sigma in (0.1, by_state, by_value):
        data = saltus.measurements(times, values, ["y", "v"], sigma=sigma)
        problem = ball(durations=[0.1, 0.2, 1.2], control=np.zeros((3, 0)), costs=[data])
        assert_allclose(saltus.loss_and_gradient(problem).loss, np.sum(((motion - values) / sigma) ** 2), rtol=1e-11)


@pytest.mark.parametrize("weight", [[1, 2], [[1, 2, 3]], np.ones((3, 1)), []])
def test_weights_of_another_number_than_the_target_are_refused(weight):
    with pytest.raises(ValueError, match=r"weight: found shape .*, expected one number, or 3, one for each component"):
        saltus.terminal([0, 1, 2], weight=weight)


def test_bounds_are_a_dict_in_which_none_is_no_bound():
    with pytest.raises(TypeError, match=r"bounds: found list, expected a dict of pairs \(least, greatest\) by names"):
        ball(bounds=[("e", (0, 1))])
    ends = []
    for pair in [(None, 0.85), (-np.inf, 0.85)]:  # the cost asks for a larger one
        problem = ball(costs=[saltus.residuals(lambda p: p[1] - 2)], optimize=["e"], bounds={"e": pair})
        ends.append(saltus.solve(problem, solver="ceres_lm", iterations=30).parameters)
    assert_allclose(ends, [[9.81, 0.85], [9.81, 0.85]], rtol=1e-12)


@pytest.mark.parametrize("region, message", [
    ({"min": [np.nan, 0]}, "min: found NaN, expected numbers, and None where there is no bound"),
    ({"min": [0, 0], "max": [1, np.nan]}, "max: found NaN"),
    ({"min": [0, 0], "weight": [1, 1, 1]}, "min and max: found them beside a target, hard or a weight"),
])
def test_wrong_goal_regions_are_refused(region, message):
    with pytest.raises(ValueError, match=message):
        saltus.terminal(**region)


@pytest.mark.parametrize("bounds, message", [
    ({"e": (np.nan, 1)}, "bounds of 'e': found nan and 1, expected no NaN"),
    ({"y": (0, np.nan)}, "bounds of 'y': found 0 and nan, expected no NaN"),
    ({"e": (0.9, 0.8)}, "bounds of 'e': found 0.9 and 0.8, expected the least one first"),
    ({"e": (np.inf, np.inf)}, "found inf and inf, expected the least one first, and a finite number between them"),
    ({"e": 1}, r"bounds of 'e': found 1, expected a pair of numbers \(least, greatest\); None is no bound"),
    ({"e": ("a", 1)}, "bounds of 'e': found .* expected a pair of numbers"),
    ({"e": None}, "bounds of 'e': found None, expected a pair of numbers"),
    ({"q": (0, 1)}, "bounds: found 'q', expected some of what is optimized: "),
    ({"duration": (-1, 1)}, "found the bounds -1 and 1 of the duration, expected a lower one of at least 0"),
    ({"duration": (-2, -1)}, "as the duration is positive"),
    ({"duration": (0, 0)}, "as the duration is positive"),
    ({"duration": (np.nan, 1)}, "bounds of 'duration': found nan and 1, expected no NaN"),
])
def test_wrong_bounds_are_refused(bounds, message):
    problem = ball(costs=[saltus.terminal([0.3, None])])
    if "duration" not in bounds or np.isnan(bounds["duration"][0]):
        with pytest.raises(ValueError, match=message):
            ball(bounds=bounds)
    with pytest.raises(ValueError, match=message):
        saltus.solve(problem, solver="ceres_lm", optimize=["y", "e", "duration"], bounds=bounds, iterations=1)
    saltus.solve(problem, solver="ceres_lm", optimize=["duration"], bounds={"duration": (-np.inf, 2)}, iterations=1)


@pytest.mark.parametrize("solver", ["ceres_lm", "ceres_lbfgs"])
def test_a_run_that_converged_has_a_certificate(solver):
    """To be at 2 after 1 s, with the effort of a constant force of 4 / 3."""
    run = saltus.solve(integrator(costs=[saltus.terminal([2.0], weight=2)]), solver=solver)
    assert run.termination == "converged"
    assert_allclose(run.control, np.full((8, 1), 4 / 3), rtol=1e-6)
    assert run.certificate["verdict"] == "stationary"


FRICTION = 3.0


def block_with_guards():
    """A block that sticks until the force is larger than the friction."""
    return saltus.HybridSystem(
        states={mode: ["x", "v"] for mode in ("stick", "right", "left")}, controls=["u"],
        flow={"stick": lambda x: [0 * x[0], 0 * x[1]],
              "right": lambda x, u: [x[1], u[0] - FRICTION],
              "left": lambda x, u: [x[1], u[0] + FRICTION]},
        guards={"stick": {"push": lambda u: FRICTION - u[0], "pull": lambda u: FRICTION + u[0]},
                "right": {"stop": lambda x: x[1]}, "left": {"stop": lambda x: -x[1]}},
        resets={"stick": {"push": lambda x: ("right", [x[0], 0.0]), "pull": lambda x: ("left", [x[0], 0.0])},
                "right": {"stop": lambda x: ("stick", [x[0], 0.0])},
                "left": {"stop": lambda x: ("stick", [x[0], 0.0])}})


def block_with_contact():
    return saltus.MechanicalSystem(
        coordinates=["x", "y"], controls=["u"], mass=lambda q: [[1.0, 0], [0, 1.0]], force=lambda u: [u[0], -10.0],
        contacts={"floor": saltus.Contact(gap=lambda q: q[1], slide=lambda q: q[0], friction=FRICTION / 10, restitution=0.0)})


def block_along_switch():
    """The motion along the switch at v = 0 is that of a block that sticks."""
    return saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], sliding="filippov",
                               flow={"m": lambda x, u: [x[1], u[0] - FRICTION * np.sign(x[1])]})


def valve_with_dead_zone():
    return saltus.HybridSystem(
        states={"m": ["x", "v"]}, controls=["u"],
        flow={"m": lambda x, u: [x[1], saltus.where(abs(u[0]) < FRICTION, 0.0, u[0] - FRICTION * np.sign(u[0]))]})


def pushed(system, effort=0.001, target=0.5, control=0.0, intervals=10):
    """From rest to the target within 1 s, and to rest there."""
    mode = {} if isinstance(system, saltus.MechanicalSystem) else {"mode": next(iter(system.states))}
    speed = 1 if mode else 2
    problem = saltus.HybridProblem(system, initial=[0] * (2 * speed), duration=1.0, control=np.zeros((intervals, 1)), **mode)
    problem.control[1:] = control
    problem.costs = [saltus.effort(effort), saltus.residuals(lambda x: [x[0] - target, x[speed]])]
    return problem


@pytest.mark.parametrize("solver", ["ceres_lm", "ceres_lbfgs", "auto"])
@pytest.mark.parametrize("system", [block_with_guards, block_along_switch, valve_with_dead_zone])
def test_a_guess_that_no_small_force_moves_is_no_optimum(system, solver):
    """Without a force the loss is 0.25, a local minimum, as small forces cost an effort and move nothing."""
    run = saltus.solve(pushed(system()), solver=solver, optimize=["control"])
    assert run.termination == "no_progress" and run.loss == 0.25
    assert "no small change of the control changes the motion, as where all contacts stick" in run.reason


@pytest.mark.parametrize("system", [block_with_guards, valve_with_dead_zone])
def test_a_constraint_that_no_small_force_changes_is_not_met(system):
    problem = pushed(system())
    problem.costs[1] = saltus.residuals(lambda x: [x[0] - 0.5, x[1]], role="equality")
    run = saltus.solve(problem, optimize=["control"])
    assert run.termination == "no_progress", run.reason


def test_phases_of_a_flow_with_a_kink_and_a_control():
    """Drag -0.3 v |v|, whose switch does not depend on the control; the motion turns, and ceres_lm finds the same."""
    system = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"],
                                 flow={"m": lambda x, u: [x[1], u[0] - 0.3 * abs(x[1]) * x[1]]})
    problem = saltus.HybridProblem(system, mode="m", initial=[0.0, 0.5], duration=2.0, control=np.zeros((10, 1)))
    for target in (1.0, -0.5):
        problem.costs = [saltus.effort(0.1), saltus.residuals(lambda x, target=target: [x[0] - target, x[1]])]
        phases, shooting = (saltus.solve(problem, solver=s, optimize=["control"]) for s in ("ceres_phases", "ceres_lm"))
        assert phases.termination == shooting.termination == "converged"
        # Where the motion turns, the intervals of the two phases have different lengths.
        assert_allclose(phases.loss, shooting.loss, rtol=1e-9 if target > 0 else 1e-4)


def test_phases_along_a_switch_that_depend_on_the_control():
    """How long the block slides along the switch depends on the force, which all rows of its phase read."""
    problem = pushed(block_along_switch(), control=5.0)
    problem.control[0] = 6.0
    run = saltus.solve(problem, solver="mode_search", optimize=["control"])
    assert run.loss <= run.initial_loss and run.reason


@pytest.mark.parametrize("solver", ["ceres_lm", "ceres_lbfgs"])
@pytest.mark.parametrize("system", [block_with_contact, valve_with_dead_zone])
def test_no_run_has_converged_beside_a_certificate_that_says_otherwise(system, solver):
    for intervals, target, control in itertools.product((4, 10), (0.2, 1.0), (4.0, -10.0)):
        problem = pushed(system(), target=target, control=control, intervals=intervals)
        run = saltus.solve(problem, solver=solver, optimize=["control"], iterations=200)
        if run.termination == "converged":
            assert run.certificate["verdict"] != "not_stationary", run.reason


def test_a_solve_that_goes_on_with_more_steps_does_not_speak_of_its_guess():
    """The catalyst mixing problem of the COPS set, whose optimum is 0.0480557 and on 20 intervals a little less."""
    if "ipopt" not in saltus.hybrid_solvers():
        pytest.skip("ipopt is not built")
    system = saltus.HybridSystem(
        states={"m": ["a", "b"]}, controls=["u"],
        flow={"m": lambda x, u: [u[0] * (10 * x[1] - x[0]), u[0] * (x[0] - 10 * x[1]) - (1 - u[0]) * x[1]]})
    problem = saltus.HybridProblem(system, mode="m", initial=[1.0, 0.0], duration=1.0, control=np.zeros((20, 1)))
    problem.costs = [saltus.cost(lambda x: x[0] + x[1] - 1)]
    run = saltus.solve(problem, optimize=["control"], bounds={"u": (0, 1)})
    assert run.termination == "converged" and -0.0480557 < run.loss < -0.04804
    assert "the guess is an optimum" not in run.reason


def test_an_audit_reads_the_start_and_single_intervals():
    """dx/dt = u is integrated exactly by Euler's scheme, whose gradient is then right."""
    terms = [saltus.residuals(lambda x0, xT: [xT[0] * x0[0] - 3]), saltus.residuals(lambda x: [x[0] - 1], at=[0.25])]
    audit = saltus.audit(integrator(initial=[2.0], costs=terms), step=lambda x, u, p, h: ("m", x + h * u), steps=16)
    assert audit.verdict == "right"


def test_a_control_on_unequal_intervals_is_audited_on_equal_ones():
    """dx/dt = u with a control on intervals of lengths 0.1, 0.4 and 0.5, as a run of phases may have: as of 10 intervals."""
    rows, durations = np.array([[1.0], [2.0], [-1.0]]), [0.1, 0.4, 0.5]
    costs = [saltus.residuals(lambda x: [x[0] ** 2 - 3])]
    problem = integrator(initial=[2.0], costs=costs, control=rows, durations=durations)
    audit = saltus.audit(problem, step=lambda x, u, p, h: ("m", x + h * u), steps=10)
    assert audit.verdict == "right" and audit.steps == 10
    end = 2 + 0.1 + 0.8 - 0.5
    held = np.repeat(rows, [1, 4, 5], axis=0)
    expected = 2 * 0.1 * held + 2 * (end**2 - 3) * 2 * end * 0.1
    assert_allclose(audit.gradient["control"], expected, rtol=1e-9)
    wrong = saltus.audit(problem, step=lambda x, u, p, h: ("m", x + h * u), jacobian=lambda x, u, p, h: [[1.0, 2 * h]], steps=10)
    assert wrong.verdict == "wrong"
    equal = integrator(initial=[2.0], costs=costs, control=rows, durations=[1 / 3] * 3)
    assert np.shape(saltus.audit(equal, step=lambda x, u, p, h: ("m", x + h * u), steps=9).gradient["control"]) == (3, 1)


class TestSequence:
    """A pendulum that swings up beside an elastic wall: the best motions with and without an impact are known (P12)."""

    def problem(self, system=None, **changes):
        system = system or saltus.MechanicalSystem(
            coordinates=["th"], controls=["u"], mass=lambda q: [[1.0]], force=lambda q, u: [u[0] - 9.81 * np.sin(q[0])],
            contacts={"wall": saltus.Contact(gap=lambda q: 0.5 - np.sin(q[0]), restitution=0.9)})
        given = {"initial": [0, 0], "duration": 1.6, "control": np.full((40, 1), 1.0),
                 "costs": [saltus.terminal([-math.pi, 0], weight=[100, 10]), saltus.effort(0.02)], **changes}
        return saltus.HybridProblem(system, **given)

    @pytest.mark.parametrize("solver", [None, "ipopt"])
    def test_an_impact_that_the_guess_does_not_have(self, solver):
        if solver is not None and solver not in saltus.hybrid_solvers():
            pytest.skip(f"{solver} is not built")
        problem = self.problem()
        assert saltus.rollout(problem).events == []
        run = saltus.solve(problem, solver=solver, sequence=["hit wall"])
        assert run.solver == (solver or "ceres_phases")
        assert run.termination == "converged", run.reason
        assert [event[1:] for event in run.events] == [("o", "hit wall", "o")]
        assert 1.29 < run.loss < 1.2940262535645844

    def test_no_impact_is_the_optimum_without_a_wall(self):
        free = saltus.MechanicalSystem(coordinates=["th"], controls=["u"], mass=lambda q: [[1.0]],
                                       force=lambda q, u: [u[0] - 9.81 * np.sin(q[0])])
        expected = saltus.solve(self.problem(system=free), solver="ceres_lm")
        assert expected.termination == "converged", expected.reason
        run = saltus.solve(self.problem(), sequence=[])
        assert run.termination == "converged", run.reason
        assert run.events == []
        assert_allclose(run.loss, expected.loss, rtol=1e-8)

    def test_refusals(self):
        problem = self.problem()
        with pytest.raises(ValueError, match=r"sequence: found \['hit floor'\], which no modes have from mode 'o' on, whose "
                                             "events are hit wall"):
            saltus.solve(problem, sequence=["hit floor"])
        with pytest.raises(ValueError, match="sequence: found one for the solver 'gd', expected ceres_phases or ipopt"):
            saltus.solve(problem, solver="gd", sequence=["hit wall"])
        with pytest.raises(TypeError, match="sequence: found 'hit wall', expected a list of names of events"):
            saltus.solve(problem, sequence="hit wall")
        with pytest.raises(ValueError, match="does not lead from the mode at the start to one in which the terms at the end"):
            saltus.solve(self.problem(costs=[saltus.terminal([0, 0], mode="n")]), sequence=["hit wall"])


class TestPages:
    @pytest.mark.parametrize("draw", [None, lambda t, x: [(t, x[0], 0.2)]])
    def test_a_rollout_and_a_run_have_a_page(self, tmp_path, draw):
        problem = ball(costs=[saltus.terminal([0.4, None])])
        saltus.rollout(problem).save_page(tmp_path / "motion", draw=draw)
        run = saltus.solve(problem, solver="ceres_lm", optimize=["e"])
        run.save_page(tmp_path / "run", draw=draw)
        for name in ("motion", "run"):
            document = json.loads((tmp_path / name / "result.json").read_text(encoding="utf-8"))
            assert [event["guard"] for event in document["motion"]["events"]][0] == "ground"
            page = (tmp_path / name / "report.html").read_text(encoding="utf-8")
            assert page.startswith("<!") and '"frames"' in page
        assert_allclose(document["runs"][0]["final_loss"], run.loss)
        with pytest.raises(ValueError, match="found a result without its problem"):
            pickle.loads(pickle.dumps(run)).save_page(tmp_path)

    def test_a_page_has_the_bounds_that_a_run_has_kept(self, tmp_path):
        def bounds_of(result):
            result.save_page(tmp_path)
            return json.loads((tmp_path / "result.json").read_text(encoding="utf-8")).get("control_bounds")

        system = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["push", "pull"], flow={"m": lambda x, u: [x[1], u[0] - u[1]]})
        problem = saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1.0, control=np.zeros((4, 2)),
                                       costs=[saltus.terminal([0.1, 0])], bounds={"push": (-2, 3)})
        assert bounds_of(saltus.rollout(problem)) == {"min": [-2, None], "max": [3, None]}
        run = saltus.solve(problem, solver="ceres_phases", bounds={"pull": (0, 1)})
        assert bounds_of(run) == {"min": [None, 0], "max": [None, 1]}
        assert bounds_of(saltus.solve(problem, solver="ceres_phases", bounds={})) is None

    def test_a_page_of_bodies_draws_them(self, tmp_path):
        problem = saltus.load_bodies(SOURCE / "problems" / "tossed_box.yaml")
        saltus.rollout(problem).save_page(tmp_path)
        page = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert '"frames"' in page and "bump" in page

    def test_a_wrong_drawing_is_refused_with_its_place(self, tmp_path):
        motion = saltus.rollout(ball())
        with pytest.raises(ValueError, match="draw: found 2 numbers, expected"):
            motion.save_page(tmp_path, draw=lambda x: [x])
        with pytest.raises(ValueError, match="draw: found an argument 'w'"):
            motion.save_page(tmp_path, draw=lambda w, x: [])
        with pytest.raises(TypeError, match="draw: found int, expected a callable"):
            motion.save_page(tmp_path, draw=3)


@pytest.mark.parametrize("optimize", [{"e": (0.5, 0.9)}, 3])
def test_what_is_optimized_is_a_list_of_names(optimize):
    """The bounds of a dict would be lost."""
    with pytest.raises(TypeError, match=r"optimize: found .*, expected a list of names; bounds are given by bounds="):
        saltus.solve(ball(), optimize=optimize)


def bounces(count, e, g=9.81, y0=1.0):
    """The times of the bounces of the ball from rest, by their closed form."""
    falls = math.sqrt(2 * y0 / g)
    return np.cumsum([falls, *(2 * falls * e**k for k in range(1, count))])


class TestTimesOfEvents:
    def test_loss_and_gradient(self):
        times = [0.4, np.nan, 1.6]
        problem = ball(duration=2.0, costs=[saltus.event_times("ground", times, sigma=[0.01, 1.0, 0.02])])
        exact = bounces(3, 0.8)
        loss = ((exact[0] - 0.4) / 0.01) ** 2 + ((exact[2] - 1.6) / 0.02) ** 2
        assert_allclose(saltus.loss_and_gradient(problem).loss, loss, rtol=1e-10)
        check_gradient(pickle.loads(pickle.dumps(problem)))

    @pytest.mark.parametrize("solver", ["ceres_lm", "ceres_lbfgs", "ceres_phases", None])
    def test_restitution_and_gravity_from_bounces(self, solver):
        """The times of four bounces are those of e = 0.7 and g = 9.6; the guess is another one."""
        data = saltus.event_times("ground", bounces(4, 0.7, 9.6), sigma=1e-3)
        problem = ball(duration=2.4, costs=[data], optimize=["g", "e"])
        run = saltus.solve(problem, **({} if solver is None else {"solver": solver}))
        assert_allclose(run.parameters, [9.6, 0.7], rtol=1e-6)
        assert run.loss < 1e-6

    def test_of_a_mechanical_system_in_any_mode(self):
        """A ball on a table: the events of one contact in the modes of both contacts."""
        system = saltus.MechanicalSystem(
            coordinates=["x", "y"], parameters=["e"], mass=lambda: np.eye(2), force=lambda: [0, -9.81],
            contacts={"wall": saltus.Contact(gap=lambda q: 0.9 - q[0], restitution=1.0),
                      "floor": saltus.Contact(gap=lambda q: q[1], restitution="e")})
        problem = saltus.HybridProblem(system, initial=[0, 1, 1, 0], parameters=[0.8], duration=2.0,
                                       costs=[saltus.event_times("hit floor", [0.5, 1.2]), saltus.event_times("hit wall", [0.8])])
        first, second = bounces(2, 0.8)
        assert_allclose(saltus.loss_and_gradient(problem).loss, (first - 0.5) ** 2 + (second - 1.2) ** 2 + 0.01, rtol=1e-10)
        check_gradient(problem, ["parameters"])
        with pytest.raises(ValueError, match="times of 'floor': found guard 'floor', expected some of hit wall, off wall, .* hit floor"):
            saltus.loss_and_gradient(saltus.HybridProblem(system, initial=[0, 1, 1, 0], parameters=[0.8], duration=2.0,
                                                          costs=[saltus.event_times("floor", [0.5])]))

    def test_a_motion_without_an_event_has_no_loss(self):
        problem = ball(duration=1.0, costs=[saltus.event_times("ground", bounces(2, 0.8))])
        message = r"times of 'ground': found 1 events 'ground' in the motion, expected at least 2; start from a guess that has them"
        with pytest.raises(RuntimeError, match=message):
            saltus.loss_and_gradient(problem)
        run = saltus.solve(problem, optimize=["e"], solver="ceres_lm")
        assert run.termination == "failed" and "expected at least 2" in run.reason

    def test_along_a_sequence_that_the_guess_does_not_have(self):
        problem = ball(initial=[0.5, 0.0], duration=0.7, optimize=["e", "y"],
                       costs=[saltus.event_times("ground", bounces(2, 0.5, y0=0.4), sigma=1e-2)])
        assert len(saltus.rollout(problem).events) == 1
        run = saltus.solve(problem, sequence=["ground", "ground"])
        assert_allclose([run.parameters[1], run.initial[0]], [0.5, 0.4], rtol=1e-5)

    def test_residuals_at_events_in_any_mode(self):
        """A ball that lands in either of two modes of equal states, by the name of the guard."""
        system = saltus.HybridSystem(
            states={"a": ["y", "v"], "b": ["y", "v"]}, flow={mode: lambda x: [x[1], -9.81] for mode in "ab"},
            guards={mode: {"ground": lambda x: x[0]} for mode in "ab"},
            resets={"a": {"ground": lambda x: ("b", [x[0], -0.8 * x[1]])}, "b": {"ground": lambda x: ("a", [x[0], -0.8 * x[1]])}})
        speed = saltus.residuals(lambda x: x[1], at="event", guard="ground")
        problem = saltus.HybridProblem(system, mode="a", initial=[1, 0], duration=1.5, costs=[speed])
        assert_allclose(saltus.loss_and_gradient(problem).loss, 2 * 9.81 * (0.8**2 + 0.8**4), rtol=1e-10)

    @pytest.mark.parametrize("solver", ["auto", "ceres_phases", "mode_search"])
    @pytest.mark.parametrize("role", ["cost", "equality"])
    def test_a_term_at_an_event_that_does_not_happen_is_named(self, role, solver):
        landing = saltus.residuals(lambda x: [x[1] - 3], at="event", mode="flight", guard="ground", role=role, name="landing")
        problem = ball(duration=0.4, costs=[landing, saltus.residuals(lambda p: [p[1] - 0.5])])
        remark = "landing has no effect, as the motion has no events 'ground' in mode 'flight'; start from a guess that has them"
        run = saltus.solve(problem, solver=solver, optimize=["e"])
        assert remark in run.reason
        gradient = saltus.loss_and_gradient(problem)
        assert remark in gradient.remark and gradient.remarks[-1]["kind"] == "guess"
        problem.duration = 0.6
        assert "no effect" not in saltus.solve(problem, solver=solver, optimize=["e"]).reason
        assert saltus.loss_and_gradient(problem).remark == ""

    @pytest.mark.parametrize("arguments, words", [
        ((["ground"], [1.0]), "guard: found list, expected text"),
        (("ground", []), "times: found .*expected a list of finite numbers, and NaN where one is missing"),
        (("ground", [np.nan]), "times: found .*expected a list of finite numbers"),
        (("ground", [1.0, np.nan, 0.5]), "found 0.5 behind a later one, expected rising times"),
        (("ground", [1.0], 0.0), "sigma: expected finite numbers > 0"),
        (("ground", [1.0], [1.0, 1.0]), r"sigma: found shape \(2,\), expected one number, or \(1,\), one for each time"),
    ])
    def test_wrong_data_are_refused(self, arguments, words):
        guard, times, *sigma = arguments
        with pytest.raises((TypeError, ValueError), match=words):
            saltus.event_times(guard, times, **({"sigma": sigma[0]} if sigma else {}))
        with pytest.raises(ValueError, match="times of 'wall': found guard 'wall', expected some of ground"):
            ball(costs=[saltus.event_times("wall", [1.0])])


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt"])
def test_a_sequence_leads_to_the_mode_of_a_term_which_the_guess_does_not_reach(solver):
    """The guess stops short of the line at x = 1, behind which the motion has to end: at best with a constant control of 2."""
    if solver not in saltus.hybrid_solvers():
        pytest.skip(f"{solver} is not built")
    system = saltus.HybridSystem(
        states={"before": ["x"], "behind": ["x"]}, controls=["u"], flow={mode: lambda u: [u[0]] for mode in ("before", "behind")},
        guards={"before": {"line": lambda x: 1 - x[0]}}, resets={"before": {"line": lambda x: ("behind", x)}})
    problem = saltus.HybridProblem(
        system, mode="before", initial=[0.0], duration=1.0, control=np.full((10, 1), 0.1),
        costs=[saltus.terminal([2.0], hard=True, mode="behind"), saltus.effort()])
    run = saltus.solve(problem, solver=solver, sequence=["line"])
    assert run.termination == "converged" and [event[2] for event in run.events] == ["line"]
    assert_allclose([run.loss, run.final[0]], [4, 2], rtol=1e-6)
    assert_allclose(np.asarray(run.control), 2, rtol=1e-3)


PHASES = ["ceres_phases", *(["ipopt"] if "ipopt" in saltus.hybrid_solvers() else [])]


class TestAlways:
    """Inequalities that hold between the beginnings of control intervals too."""

    @staticmethod
    def point(costs, initial=(0, 1), **changes):
        line = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], flow={"m": lambda x, u: [x[1], u[0]]})
        given = {"mode": "m", "initial": initial, "duration": 1.0, "control": np.zeros((10, 1)), **changes}
        return saltus.HybridProblem(line, costs=costs, **given)

    @pytest.mark.parametrize("solver", PHASES)
    def test_the_top_of_a_throw_within_one_interval(self, solver):
        """Back at 0 after 1 s under a constant force, the top is at v / 4, which is to be 0.1 at most, of the largest v."""
        def solved(at):
            low = saltus.residuals(lambda x: x[0] - 0.1, at=at, role="inequality")
            problem = self.point([saltus.maximise(lambda x0: x0[1]), saltus.terminal([0, None], hard=True), low], (0, 0.2),
                                 control=[[-0.4]], optimize=["control", "v"], bounds={"v": (0, 3)})
            return saltus.solve(pickle.loads(pickle.dumps(problem)), solver=solver)

        run = solved("always")
        assert run.termination == "converged" and run.certificate["verdict"] == "stationary"
        assert_allclose(run.initial, [0, 0.4], atol=1e-8)
        assert solved("steps").initial[1] > 2

    @pytest.mark.parametrize("intervals", [7, 20])
    def test_bryson_and_denham(self, intervals):
        """x <= 1/9 at all times, by the parabolas between the beginnings of intervals."""
        tops = {}
        for at in ("steps", "always"):
            limit = saltus.residuals(lambda x: x[0] - 1 / 9, at=at, role="inequality")
            run = saltus.solve(self.point([saltus.effort(0.5), saltus.terminal([0, -1], hard=True), limit],
                                          control=np.zeros((intervals, 1))))
            assert run.termination == "converged", run.reason
            x, v, top = 0.0, 1.0, 0.0
            for (u,), h in zip(np.asarray(run.control), run.durations):
                inside = 0 < -v / u < h if u != 0 else False
                x, v, top = x + v * h + u * h * h / 2, v + u * h, max(top, x - v * v / (2 * u) if inside else x)
            tops[at] = (top - 1 / 9, run.loss)
        assert tops["steps"][0] > 5e-5 and abs(tops["always"][0]) < 1e-8
        assert tops["always"][1] > tops["steps"][1] + 1e-3 and tops["always"][1] > 4

    @pytest.mark.parametrize("solver", PHASES)
    def test_the_top_behind_a_bounce(self, solver):
        """Thrown down from 0.5 m, the ball may not rise above 1 m behind its bounce, with e = 0.8."""
        problem = ball(initial=[0.5, -1.0], duration=1.0, control=np.zeros((8, 0)), optimize=["v"], bounds={"v": (-10, 0)},
                       costs=[saltus.cost(lambda x0: x0[1]), saltus.residuals(lambda x: x[0] - 1, at="always", role="inequality")])
        run = saltus.solve(problem, solver=solver)
        assert_allclose(run.initial[1], -math.sqrt(2 * 9.81 / 0.64 - 9.81), rtol=1e-8)
        assert run.certificate["verdict"] == "stationary"

    @pytest.mark.parametrize("solver", PHASES)
    def test_of_state_time_control_and_parameters_in_two_modes(self, solver):
        """The largest value along the solution, by another integration, is zero in one mode and below it in the other."""
        integrate = pytest.importorskip("scipy.integrate")

        def flow(x, u, p):
            return [x[1], p[0] * u[0] - x[0] ** 3]

        def limits(x, t, u, p):
            return [x[1] * np.cos(t) + 0.1 * u[0] - p[1], x[0] - 3]

        system = saltus.HybridSystem(
            states={"left": ["x", "v"], "right": ["x", "v"]}, controls=["u"], parameters=["gain", "limit"],
            flow={"left": flow, "right": flow}, guards={"left": {"line": lambda x: 0.5 - x[0]}},
            resets={"left": {"line": lambda x: ("right", [x[0], 0.9 * x[1]])}})
        problem = saltus.HybridProblem(
            system, mode="left", initial=[0, 0], parameters=[2.0, 0.6], duration=1.5, control=np.full((6, 1), 0.5),
            costs=[saltus.effort(), saltus.terminal([1.0, None], hard=True, mode="right"),
                   saltus.residuals(limits, at="always", role="inequality")])
        run = saltus.solve(problem, solver=solver)
        assert run.termination == "converged" and run.certificate["verdict"].startswith("stationary"), run.reason
        (hit, *_), = run.events
        state, begin, greatest = [0.0, 0.0], 0.0, -np.inf
        for (u,), h in zip(np.asarray(run.control), run.durations):
            end = begin + h
            for part in ((begin, hit), (hit, end)) if begin - 1e-9 <= hit < end - 1e-9 else ((begin, end),):
                if part[0] == hit:
                    state[1] *= 0.9
                if part[1] - part[0] > 1e-9:
                    arc = integrate.solve_ivp(lambda t, x: flow(x, [u], [2.0]), part, state, rtol=1e-12, atol=1e-13,
                                              t_eval=np.linspace(*part, 2001))
                    greatest = max(greatest, np.max(arc.y[1] * np.cos(arc.t) + 0.1 * u - 0.6))
                    state = list(arc.y[:, -1])
            begin = end
        assert abs(greatest) < 1e-6 and abs(state[0] - 1) < 1e-6

    @pytest.mark.parametrize("solver", ["ceres_phases", "ipopt"])
    @pytest.mark.parametrize("intervals", [1, 2, 3, 8])
    def test_behind_an_event_too(self, intervals, solver):
        """Intervals end at the event, so that the part behind it is not left out: the speed is greatest after the bounce."""
        ball = saltus.HybridSystem(
            states={"f": ["y", "v"]}, controls=["u"], flow={"f": lambda x, u: [x[1], u[0] - 10]},
            guards={"f": {"ground": lambda x: x[0]}}, resets={"f": {"ground": lambda x: ("f", [0, -0.8 * x[1]])}})
        limit = saltus.residuals(lambda x: x[1] - 3.2, at="always", role="inequality")
        problem = saltus.HybridProblem(ball, mode="f", initial=[1.25, 0], duration=1.0, control=np.zeros((intervals, 1)),
                                       costs=[saltus.terminal([1, 0], weight=10), saltus.effort(0.05), limit])
        run = saltus.solve(problem, solver=solver)
        if intervals == 1:  # the interval cannot end at the event
            assert run.termination == "failed" and "expected an interval for each phase" in run.reason
            return
        assert (run.termination, run.certificate.verdict) == ("converged", "stationary")
        assert "of controls whose intervals end at the events, as" in run.certificate.reason
        state, begin, (hit, *_) = [1.25, 0.0], 0.0, run.events[0]
        assert min(abs(np.cumsum(run.durations) - hit)) < 1e-9
        for (u,), h in zip(np.asarray(run.control), run.durations):
            if abs(begin - hit) < 1e-9:
                state = [0.0, -0.8 * state[1]]
            assert state[1] < 3.2 + 1e-8 and state[1] + (u - 10) * h < 3.2 + 1e-8
            state = [state[0] + h * state[1] + (u - 10) * h**2 / 2, state[1] + (u - 10) * h]
            begin += h

    @pytest.mark.parametrize("arguments, words", [
        ({"function": lambda x: x[0]}, "at: found 'always' with the role 'cost', expected 'inequality'; a cost over time is one at steps"),
        ({"function": lambda x, h: x[0] * h, "role": "inequality"},
         "found an argument 'h', the length of an interval, .* expected some of t, x, u and p. Take at=\"steps\" for a term with h"),
        ({"function": lambda x, u: x[0] * u[0], "role": "inequality", "at": "end"},
         "found an argument 'u' of a term at=\"end\", expected some of t, x and p. Only a term at=\"steps\" reads the control u"),
        ({"function": lambda xT: xT[0], "role": "inequality"}, "only a term at the end reads the states x0 at the start and xT"),
        ({"function": lambda x: x[0], "role": "inequality", "mode": "n"}, "found 'n', expected some of m"),
        ({"function": lambda x: x[5], "role": "inequality", "name": "far"}, "far: IndexError: index 5 is out of bounds"),
        ({"function": lambda x, q: x[0], "role": "inequality"}, "found an argument 'q'"),
    ])
    def test_what_cannot_hold_always_is_refused(self, arguments, words):
        with pytest.raises((ValueError, RuntimeError), match=words):
            self.point([saltus.residuals(**{"at": "always", **arguments})])

    @pytest.mark.parametrize("solver", PHASES)
    @pytest.mark.parametrize("mode", [None, "o"])
    def test_the_top_of_a_mechanical_system_behind_a_bounce(self, solver, mode):
        """As of a ball above, in the mode in which nothing touches; pickled, too."""
        disc = saltus.MechanicalSystem(coordinates=["y"], mass=lambda: [[2.0]], force=lambda: [-2 * 9.81],
                                       contacts={"floor": saltus.Contact(gap=lambda q: q[0], restitution=0.8)})
        limit = saltus.residuals(lambda x: x[0] - 1, at="always", role="inequality", mode=mode)
        problem = saltus.HybridProblem(disc, initial=[0.5, -1.0], duration=1.0, control=np.zeros((8, 0)), optimize=["dy"],
                                       bounds={"dy": (-10, 0)}, costs=[saltus.cost(lambda x0: x0[1]), limit])
        run = saltus.solve(pickle.loads(pickle.dumps(problem)), solver=solver)
        assert_allclose(run.initial[1], -math.sqrt(2 * 9.81 / 0.64 - 9.81), rtol=1e-8)
        assert run.certificate["verdict"] == "stationary"

    def test_modes_of_a_pickled_mechanical_system_are_those_of_their_names(self):
        """A block on the floor, beside a wall that it never touches: modes have other numbers once they were met in another order."""
        block = saltus.MechanicalSystem(
            coordinates=["y", "z"], mass=lambda: np.eye(2), force=lambda: [-9.81, 0],
            contacts={"wall": saltus.Contact(gap=lambda q: q[1] + 1, restitution=0), "floor": saltus.Contact(gap=lambda q: q[0], restitution=0)})
        for status in ("nn", "no"):
            block._system.mode(status)
        problem = saltus.HybridProblem(block, initial=[0, 0, 0, 1], duration=1.0, control=np.zeros((2, 0)),
                                       costs=[saltus.residuals(lambda x: x[1], at="steps", mode="on")])
        assert_allclose(saltus.loss_and_gradient(problem).loss, 0.25, rtol=1e-12)
        assert saltus.loss_and_gradient(pickle.loads(pickle.dumps(problem))).loss == saltus.loss_and_gradient(problem).loss

    def test_a_system_of_thousands_of_modes(self):
        """Six contacts may stick, slide either way or be open; thrown up from 1, the disc stays below 2 with v^2 / 2 g = 1."""
        contacts = {f"wall {i}": saltus.Contact(gap=lambda q, i=i: q[0] + i, slide=lambda q: q[1], restitution=0, friction=0.1) for i in range(6)}
        disc = saltus.MechanicalSystem(coordinates=["y", "z"], mass=lambda: np.eye(2),
                                       force=lambda: [-9.81, 0], contacts=contacts)
        limit = saltus.residuals(lambda x: x[0] - 2, at="always", role="inequality")
        problem = saltus.HybridProblem(disc, initial=[1, 0, 1, 0], duration=0.6, control=np.zeros((2, 0)), optimize=["dy"],
                                       bounds={"dy": (0, 10)}, costs=[saltus.cost(lambda x0: -x0[2]), limit])
        run = saltus.solve(problem, solver="ceres_phases")
        assert_allclose(run.initial[2], math.sqrt(2 * 9.81), rtol=1e-8)


@pytest.mark.parametrize("at", ["steps", [0.5]])
def test_a_term_at_the_time_of_an_event_is_remarked(at):
    """A ball that bounces at 0.5, where the speed that the term reads jumps from -5 to 2.5."""
    falls = saltus.HybridSystem(
        states={"f": ["y", "v"]}, flow={"f": lambda x: [x[1], -10]}, guards={"f": {"ground": lambda x: x[0]}},
        resets={"f": {"ground": lambda x: ("f", [0, -0.5 * x[1]])}})
    for height in (1.25, 1.25 + 1e-6, 1.25 - 1e-6):
        problem = saltus.HybridProblem(falls, mode="f", initial=[height, 0], duration=1.2, control=np.zeros((2, 0)),
                                       durations=[0.5, 0.7], costs=[saltus.residuals(lambda x: x[1], at=at)])
        found = saltus.loss_and_gradient(problem)
        jumps = "guard 'ground' has an event at t = 0.5, where cost at" in found.remark
        assert jumps == (height == 1.25), found.remark
        assert jumps == any("the loss jumps as the event crosses this time" in remark["text"] for remark in found.remarks)


@pytest.mark.parametrize("scale", [1, 1e-4, 1e-6, 1e-7])
@pytest.mark.parametrize("solver", ["auto", "ceres_phases"])
def test_an_inequality_in_small_units_is_not_taken_as_active(scale, solver):
    """From x = 0 with x' = u towards x(1) = 2: the bound x(1) <= 5 is far, whatever the unit in which it is written."""
    system = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda x, u: [u[0]]})
    far = saltus.residuals(lambda x: scale * (x[0] - 5), at="end", role="inequality")
    problem = saltus.HybridProblem(system, mode="m", initial=[0], duration=1, control=np.zeros((4, 1)),
                                   costs=[saltus.terminal([2.0]), saltus.effort(0.1), far])
    run = saltus.solve(problem, solver=solver, bounds={"u": (-3, 3)})
    assert run.termination == "converged", run.reason
    assert_allclose(run.loss, 4 * 0.1 / 1.1, rtol=1e-6)


def test_a_guess_that_hardly_moves_is_no_optimum():
    """The component without a guess is the one that matters; that with a guess of 1e-7 must not set its size."""
    system = saltus.HybridSystem(states={"m": ["x", "y"]}, controls=["a", "b"], flow={"m": lambda x, u: [u[0], u[1]]})
    problem = saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1, control=np.tile([0, 1e-7], (4, 1)),
                                   costs=[saltus.terminal([1.0, None]), saltus.cost(lambda x: 0.3 * x[1]**4),
                                          saltus.effort(0.1)])
    run = saltus.solve(problem)
    assert run.termination == "converged", run.reason
    assert_allclose(run.loss, 0.1 / 1.1, rtol=1e-6)


@pytest.mark.parametrize("solver", ["auto", "ceres_phases"])
def test_a_maximum_at_a_bound_that_does_not_press_is_left(solver):
    """The loss (x(1)^2 - 1)^2 + 0.1 int u^2 has its maximum at the guess, at the bound u >= 0, where its slope is zero."""
    system = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda x, u: [u[0]]})
    problem = saltus.HybridProblem(system, mode="m", initial=[0], duration=1, control=np.zeros((4, 1)),
                                   costs=[saltus.residuals(lambda x: [x[0]**2 - 1]), saltus.effort(0.1)])
    run = saltus.solve(problem, solver=solver, bounds={"u": (0, 1)})
    assert run.termination == "converged", run.reason
    assert_allclose(run.loss, 0.0975, rtol=1e-6)


LINE = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], flow={"m": lambda x, u: [x[1], u[0]]})


def constrained(kind, unit, of_state, of_control, control):
    """To x(1) = 1 in other units, with a constraint that is written in its own."""
    system = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"],
                                 flow={"m": lambda x, u: [x[1], u[0] * of_state / of_control]})
    limits = {
        "end": saltus.residuals(lambda x: unit * (x[1] / of_state - 0.2), role="equality"),
        "at most": saltus.residuals(lambda x: unit * (x[1] / of_state - 0.2), role="inequality"),
        "far": saltus.residuals(lambda x: unit * (x[1] / of_state - 5), role="inequality"),
        "path": saltus.residuals(lambda x: unit * (x[1] / of_state - 1.1), at="steps", role="inequality"),
        "always": saltus.residuals(lambda x: unit * (x[1] / of_state - 1.1), at="always", role="inequality"),
        "norm": saltus.residuals(lambda u: unit * ((u[0] / of_control)**2 - 4), at="steps", role="inequality"),
    }
    return saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1, control=np.full((8, 1), control * of_control),
                                costs=[saltus.terminal([of_state, None], weight=1 / of_state**2),
                                       saltus.effort(0.01 / of_control**2), limits[kind]])


@pytest.mark.parametrize("kind", ["end", "at most", "far", "path", "always", "norm"])
@pytest.mark.parametrize("solver", ["auto", *PHASES])
def test_units_do_not_change_the_solution(kind, solver):
    usual = np.asarray(saltus.solve(constrained(kind, 1, 1, 1, 0.1), solver="ceres_phases").control)
    units = [1e-6, 1e-3, 1e3, 1e6]
    for unit, of_state, of_control in [*[(u, 1, 1) for u in units], *[(1, u, 1) for u in units], *[(1, 1, u) for u in units],
                                       (1e-6, 1e3, 1e-3), (1e6, 1e-3, 1e3)]:
        for control in (0, 0.1):
            run = saltus.solve(constrained(kind, unit, of_state, of_control, control), solver=solver)
            where = f"{unit:g} {of_state:g} {of_control:g} from {control}: "
            assert run.termination == "converged", where + run.reason
            assert_allclose(np.asarray(run.control) / of_control, usual, atol=1e-6, err_msg=where)


@pytest.mark.parametrize("solver", PHASES)
@pytest.mark.parametrize("guess", [1e-12, 1e-7, 1e-3, 1e2, 1e5])
def test_the_size_of_a_guess_does_not_matter(guess, solver):
    system = saltus.HybridSystem(states={"m": ["x", "y"]}, controls=["a", "b"], flow={"m": lambda x, u: [u[0], u[1]]})
    to_one, both = saltus.terminal([1.0, None]), saltus.effort(0.1)
    curved = saltus.residuals(lambda x: [x[1]**2])
    for costs, control, loss in ((to_one, [0, guess], 0.1 / 1.1), (saltus.terminal([1.0, 1.0]), [guess, guess], 0.2 / 1.1)):
        terms = [costs, both, *([curved] if costs is to_one else [])]
        problem = saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1, control=np.tile(control, (4, 1)), costs=terms)
        run = saltus.solve(problem, solver=solver)
        assert run.termination == "converged", run.reason
        assert_allclose(run.loss, loss, rtol=1e-9)
    stop = saltus.HybridProblem(LINE, mode="m", initial=[0, 0], duration=1, control=np.full((8, 1), guess),
                                costs=[saltus.terminal([1.0, 0.0], hard=True), saltus.effort(0.1)])
    run = saltus.solve(stop, solver=solver)
    assert run.termination == "converged", run.reason
    assert_allclose(run.loss, 1.2190476190476191, rtol=1e-6)


@pytest.mark.parametrize("solver", ["auto", *PHASES])
@pytest.mark.parametrize("intervals", [1, 3])
@pytest.mark.parametrize("guess", [[1.0, 0.0], [1.0, 1e-9], [0.5, 0.0]])
def test_a_saddle_on_a_bound_of_the_norm_is_left(guess, intervals, solver):
    """On the circle |u| = 1 the loss -x - 1.5 y^2 at the end has a saddle at u = (1, 0), and its minimum at u_x = 1/3."""
    system = saltus.HybridSystem(states={"m": ["x", "y"]}, controls=["a", "b"], flow={"m": lambda x, u: [u[0], u[1]]})
    problem = saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1, control=np.tile(guess, (intervals, 1)),
                                   costs=[saltus.cost(lambda x: -x[0] - 1.5 * x[1]**2),
                                          saltus.residuals(lambda u: u[0]**2 + u[1]**2 - 1, at="steps", role="inequality")])
    run = saltus.solve(problem, solver=solver)
    assert run.termination == "converged", run.reason
    assert_allclose(run.loss, -5 / 3, atol=1e-8)


@pytest.mark.skipif("ipopt" not in PHASES, reason="this build has no IPOPT")
@pytest.mark.parametrize("iterations", [8, 10, 12, 14])
def test_ipopt_if_interrupted_returns_something_better_than_its_guess(iterations):
    system = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], flow={"m": lambda x, u: [x[1], u[0] - 10 * np.sin(x[0])]})
    slow = saltus.residuals(lambda x: x[1] - 3, at="steps", role="inequality")
    for costs in ([], [slow]):
        problem = saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=2, control=np.zeros((40, 1)),
                                       costs=[saltus.terminal([2.0, 0.0], weight=100), saltus.effort(0.01), *costs])
        run = saltus.solve(problem, solver="ipopt", bounds={"u": (-5, 5)}, iterations=iterations)
        assert run.termination == "iteration_limit", run.reason
        assert run.loss < 0.99 * run.losses[0]
        x, speeds = np.zeros(2), []
        for (u,) in np.asarray(run.control):
            speeds.append(x[1])
            flow = lambda x, u=u: np.array([x[1], u - 10 * np.sin(x[0])])
            for _ in range(10):
                a = flow(x)
                b = flow(x + 0.0025 * a)
                c = flow(x + 0.0025 * b)
                x = x + 0.005 / 6 * (a + 2 * b + 2 * c + flow(x + 0.005 * c))
        assert not costs or max(speeds) < 3 + 1e-6


@pytest.mark.parametrize("optimize", [["control"], ["control", "duration", "gain"]])
def test_costs_of_intervals_are_rows_of_their_own_variables(optimize):
    """Three controls, which blocks of eight variables cut, on intervals of different lengths: two solvers agree."""
    system = saltus.HybridSystem(
        states={"move": ["x", "y", "z"]}, controls=["a", "b", "c"], parameters=["gain"],
        flow={"move": lambda x, u, p: [p[0] * u[0], u[1] + 0.3 * x[0], u[2] - x[1] ** 2]})
    problem = saltus.HybridProblem(
        system, mode="move", initial=[0.0, 0.5, 0.0], duration=1.0, parameters=[0.8], control=np.full((11, 3), 0.1),
        durations=np.linspace(1, 2, 11) / np.linspace(1, 2, 11).sum(),
        costs=[saltus.residuals(lambda x: [5 * (x[0] - 1), 5 * (x[1] - 2), 5 * (x[2] + 1)]), saltus.effort(0.1),
               saltus.residuals(lambda u: [0.2 * (u[0] - u[1] * u[2])], at="steps"),
               saltus.residuals(lambda p: [0.5 * (p[0] - 1)])])
    if "duration" in optimize:
        problem.costs = [*problem.costs, saltus.residuals(lambda t: [0.4 * t])]
    shot, phases = (saltus.solve(problem, solver=solver, optimize=optimize, bounds={"duration": (0.2, 5)} if "duration" in optimize else {})
                    for solver in ("ceres_lm", "ceres_phases"))
    assert shot.termination == phases.termination == "converged"
    assert_allclose(shot.loss, phases.loss, rtol=1e-8)
    assert_allclose(shot.control, phases.control, atol=1e-4)


@pytest.mark.parametrize(("role", "at"), [("equality", "end"), ("inequality", "steps"), ("inequality", "always")])
@pytest.mark.parametrize("reads", [lambda x, p: [1 - x[0]], lambda t, x, p: [1 - x[0] - 0 * t]])
def test_a_constraint_may_name_parameters_that_its_system_has_not(role, at, reads):
    problem = integrator(initial=[2.0])
    problem.costs = [saltus.effort(), saltus.residuals(reads, role=role, at=at)]
    run = saltus.solve(problem)
    assert run.termination == "converged", run.reason
    assert_allclose(run.loss, 1.0 if role == "equality" else 0.0, atol=1e-8)  # from 2 to 1 in 1 s, or at rest


KINKS = [
    (saltus.cost(lambda x: abs(x[0] - 1)), "x - 1"),
    (saltus.residuals(lambda x: [1 + abs(x[0] - 1)]), "x - 1"),
    (saltus.cost(lambda x, p: x[0] * np.maximum(p[0], p[1])), "a - b"),
    (saltus.cost(lambda p: saltus.where(p[0] > 1, 3 * p[0], p[0] + 2)), "a - 1"),
    (saltus.residuals(lambda x: [np.maximum(x[0], 0.5)], at="steps"), "x - 0.5"),
]


@pytest.mark.parametrize("cost, number", KINKS)
def test_a_kink_of_a_cost_where_the_motion_is_has_a_remark(cost, number):
    system = saltus.HybridSystem(states={"m": ["x", "v"]}, parameters=["a", "b"], flow={"m": lambda x: [x[1], 0.0]})

    def make(x, a):
        return saltus.HybridProblem(
            system, mode="m", initial=[x, 1], parameters=[a, 1], duration=1.0, control=np.zeros((4, 0)), costs=[cost]
        )

    at_kink = saltus.loss_and_gradient(make(0.0, 1.0))
    assert " is not smooth at t = " in at_kink.remark and f"'{number}'" in at_kink.remark
    assert [remark["kind"] for remark in at_kink.remarks] == ["derivative"]
    assert saltus.loss_and_gradient(make(0.01, 1.01)).remark == ""  # beside it
    batch = saltus.HybridBatch(make(0.0, 1.0), optimize=["initial", "parameters"])
    with pytest.warns(RuntimeWarning, match="not smooth"):
        batch.loss_and_gradient([[0.0, 1, 1, 1], [0.01, 1, 1.01, 1]])
    assert list(batch.remarks) == [0]


@pytest.mark.parametrize(
    "cost",
    [
        saltus.residuals(lambda x: [np.maximum(x[0] - 1, 0)]),  # whose square is smooth
        saltus.cost(lambda x: abs(x[2])),  # of a state that nothing moves
        saltus.cost(lambda x: x[0] + saltus.where(x[0] > 1, 0.0, 0.0)),
    ],
)
def test_a_number_that_is_zero_where_no_derivative_jumps_has_no_remark(cost):
    system = saltus.HybridSystem(states={"m": ["x", "v", "z"]}, flow={"m": lambda x: [x[1], 0.0, 0.0]})
    problem = saltus.HybridProblem(system, mode="m", initial=[0, 1, 0], duration=1.0, costs=[cost])
    batch = saltus.HybridBatch(problem, optimize=["duration"])
    batch.loss_and_gradient([[1.0]])
    assert batch.remarks == {}
