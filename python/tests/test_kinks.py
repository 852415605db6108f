"""Optima where solvers meet a kink of the loss, or take a smooth place for one: compared with other solvers and steps."""

import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

import saltus


def tank(height, target, intervals):
    """A tank that overflows above h = 1: its flow is continuous, and so is the slope of the loss."""
    outflow = lambda x, u, p: u[0] - p[0] * np.sqrt(x[0])
    system = saltus.HybridSystem(
        states={"low": ["h", "q"], "high": ["h", "q"]}, controls=["u"], parameters=["c"],
        flow={"low": lambda x, u, p: [outflow(x, u, p), x[0]],
              "high": lambda x, u, p: [outflow(x, u, p) - 2 * (x[0] - 1), x[0]]},
        guards={"low": {"up": lambda x: 1 - x[0]}, "high": {"down": lambda x: x[0] - 1}},
        resets={"low": {"up": lambda x: ("high", x)}, "high": {"down": lambda x: ("low", x)}})
    return saltus.HybridProblem(system, mode="low", initial=[height, 0], parameters=[0.5], duration=2.0,
                                control=np.full((intervals, 1), 1.2),
                                costs=[saltus.terminal(target, weight=[4, 4]), saltus.effort(0.05)])


@pytest.mark.parametrize("case", [(0.33, [0.6, 2.8], 7), (0.52, [0.7, 1.9], 12), (0.87, [0.9, 2.1], 8)])
def test_a_guard_that_just_reaches_zero_is_left_where_the_loss_is_smooth(case):
    problem = tank(*case)
    found, other = saltus.solve(problem), saltus.solve(problem, solver="ceres_lm")
    assert found.termination == other.termination == "converged"
    # The intervals move with the events in one of them only.
    assert found.loss < 1.05 * other.loss


def test_impacts_at_the_same_time_that_share_nothing_are_left():
    """Two discs reach a wall at the same time at an optimum of the sequence that the guess has."""
    bodies = [{"name": "a", "radius": 0.1, "mass": 1.0, "position": [-1.0, -0.3], "velocity": [1.98, 0.5]},
              {"name": "b", "radius": 0.12, "mass": 0.7, "position": [0, 0.1], "velocity": [0, 0]}]
    scene = saltus.Scene({
        "name": "s", "duration": 1.0, "steps": 24, "gravity": [0, 0], "contact": {"restitution": 0.8},
        "planes": [{"name": "w", "point": [0.8, 0], "normal": [-1, 0]}], "bodies": bodies,
        "control": {"bodies": ["a"], "initial": [[1.05, 0.3]]}, "optimize": "control",
        "objective": {"terminal": [{"body": "b", "quantity": "position", "target": [-0.2, 0.6], "weight": 5.0}], "effort": 0.02}})
    run = saltus.solve(scene, "event", "ceres_phases")
    assert run.termination == "converged"
    # The optimum with both impacts at the same time has 1.53; an interior point method finds one with 0.0506.
    assert run.exact_loss < 0.0507


def test_a_free_start_whose_own_cost_is_met_exactly_is_stationary():
    """x can reach its target, y and v cannot reach both of theirs: the costate of x is zero all along."""
    system = saltus.HybridSystem(states={"m": ["x", "y", "v"]},
                                 flow={"m": lambda x: [1 + 0.1 * np.sin(x[0]), x[2], -np.sin(x[1])]})
    problem = saltus.HybridProblem(system, mode="m", initial=[0.3, 0.2, 1.0], duration=2.0, optimize=["x", "y"],
                                   costs=[saltus.terminal([3.0, 1.0, 2.0])])
    for solver in ("ceres_phases", "ceres_lm", "ceres_lbfgs"):
        run = saltus.solve(problem, solver=solver)
        assert (run.termination, run.certificate.verdict) == ("converged", "stationary"), (solver, run.reason)
        for step in ([1e-3, 0, 0], [-1e-3, 0, 0], [0, 1e-3, 0], [0, -1e-3, 0]):
            beside = saltus.HybridProblem(system, mode="m", initial=np.add(run.initial, step), duration=2.0, costs=problem.costs)
            assert saltus.loss_and_gradient(beside).loss > run.loss


@pytest.mark.parametrize("force", [0.0, 5.0, 9.8])
def test_the_sequence_that_is_asked_for_is_that_of_the_result(force):
    """A ball that must not touch the ground, from guesses in which it does, and one in which it hovers."""
    system = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["f"], flow={"flight": lambda x, u: [x[1], u[0] - 9.8]},
        guards={"flight": {"ground": lambda x: x[0]}}, resets={"flight": {"ground": lambda x: ("flight", [0, -0.7 * x[1]])}})
    problem = saltus.HybridProblem(system, mode="flight", initial=[1.0, 0], duration=1.0, control=np.full((6, 1), force),
                                   costs=[saltus.terminal([1, 0]), saltus.effort(0.1)])
    run = saltus.solve(problem, sequence=[])
    assert run.termination == "converged" and len(run.events) == 0
    # Without the ground the problem is linear in the force and the loss a square.
    free = saltus.HybridSystem(states={"m": ["y", "v"]}, controls=["f"], flow={"m": lambda x, u: [x[1], u[0] - 9.8]})
    best = saltus.solve(saltus.HybridProblem(free, mode="m", initial=[1.0, 0], duration=1.0, control=np.zeros((6, 1)),
                                             costs=problem.costs), solver="ceres_lm")
    assert_allclose(run.loss, best.loss, rtol=1e-7)


def bounces(**changes):
    system = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["f"], parameters=["g", "e"],
        flow={"flight": lambda x, u, p: [x[1], -p[0] + u[0]]}, guards={"flight": {"ground": lambda x: x[0]}},
        resets={"flight": {"ground": lambda x, p: ("flight", [0, -p[1] * x[1]])}})
    return saltus.HybridProblem(system, mode="flight", **changes)


def check_minimum(problem, run):
    """Compares the optimum with that of another method, with the intervals as they are."""
    assert run.termination == "converged" and run.certificate.curvature["kind"] == "minimum"
    problem.start_from(run)

    def loss(control):
        problem.control = np.reshape(control, np.shape(run.control))
        return saltus.loss_and_gradient(problem).loss

    found = scipy.optimize.minimize(loss, np.ravel(run.control), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    assert_allclose([found.fun, *found.x], [run.loss, *np.ravel(run.control)], rtol=1e-6)


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt", "auto"])
def test_an_event_leaves_the_end_of_its_interval_for_a_lower_loss(solver):
    """A ball with two intervals. With their border at the impact, which moves with it, the loss is 4.47098 at best."""
    problem = bounces(initial=[1.986, 1.83], parameters=[9.8, 0.715], duration=1.0254, control=np.zeros((2, 1)),
                      costs=[saltus.terminal([1.7376, 1.1459], weight=[5.64, 22.65]), saltus.effort(0.1763)])
    run = saltus.solve(problem, solver=solver)
    assert run.certificate.verdict == "stationary_on_grid" and run.loss < 4.4705
    check_minimum(problem, run)


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt", "auto"])
def test_fewer_intervals_than_phases(solver):
    problem = bounces(initial=[1.0, 0.0], parameters=[9.8, 0.8], duration=1.5, control=np.zeros((2, 1)),
                      costs=[saltus.terminal([0.5, 0.3], weight=[20, 5]), saltus.effort(0.1)])
    run = saltus.solve(problem, solver=solver)
    assert len(run.events) == 2 and run.certificate.verdict == "stationary_on_grid"
    check_minimum(problem, run)


@pytest.mark.parametrize("intervals", [4, 8, 20])
def test_a_cost_of_nodes_jumps_as_an_event_crosses_one(intervals):
    """The state that the cost reads at the end of an interval is that before the event, or behind it."""
    system = saltus.HybridSystem(
        states={"a": ["x", "v"], "b": ["x", "v"]}, controls=["u"], flow=dict.fromkeys("ab", lambda x, u: [x[1], u[0]]),
        guards={"a": {"g": lambda t, x: 0.55 + 0.3 * x[1] - t}},
        resets={"a": {"g": lambda x: ("b", [x[0] + 0.2 * x[1], 0.6 * x[1]])}})
    problem = saltus.HybridProblem(
        system, mode="a", initial=[0, 0.5], duration=1.0, control=np.zeros((intervals, 1)),
        costs=[saltus.terminal([None, 0.56]), saltus.effort(0.04), saltus.residuals(lambda x: [0.3 * x[0] - 0.1], at="steps")])
    run = saltus.solve(problem, solver="ceres_phases")
    problem.start_from(run)
    kind = run.certificate.get("curvature", {}).get("kind")
    assert run.termination == "converged" and run.certificate.verdict in ("stationary_on_grid", "not_applicable")
    losses = []
    for i in range(intervals):
        for step in (1e-6, -1e-6, 1e-4, -1e-4):
            problem.control = np.asarray(run.control) + step * np.eye(intervals)[:, [i]]
            losses.append(saltus.loss_and_gradient(problem).loss)
    if kind == "minimum":
        assert min(losses) >= run.loss * (1 - 1e-12)
    else:
        assert "the loss is not continuous as the impact a-g leaves the end of its control interval" in run.certificate.reason


def test_a_guard_that_reads_the_control_waits_for_its_jump():
    """The event is at the jump of the control, however much the guard is above zero before: a kink on one side."""
    system = saltus.HybridSystem(
        states={"a": ["x", "v"], "b": ["x", "v"]}, controls=["u"],
        flow={"a": lambda x, u: [x[1], u[0] - 0.5 * x[0]], "b": lambda x, u: [x[1], -0.5 * x[1] + u[0]]},
        guards={"a": {"g": lambda x, u: 1 - x[0] + 0.1 * u[0]}}, resets={"a": {"g": lambda x: ("b", [x[0], 0.5 * x[1]])}})
    problem = saltus.HybridProblem(system, mode="a", initial=[0.3, 0.9], duration=1.1, control=np.zeros((2, 1)),
                                   costs=[saltus.terminal([1.04, 0.0], weight=7.5), saltus.effort(0.27)])
    run = saltus.solve(problem, solver="ceres_phases")
    problem.start_from(run)
    problem.control = np.asarray(run.control) - np.array([[1e-3], [0]])
    falls = saltus.loss_and_gradient(problem).loss < run.loss * (1 - 1e-6)
    assert falls == (run.termination != "converged")
    assert falls == (run.certificate.verdict == "not_stationary")


def quadratic_program(lengths, rows, targets):
    """The forces on intervals of these lengths with the least effort, whose products with rows are the targets; and the effort."""
    inverse = 1 / lengths
    gram = (rows * inverse) @ rows.T
    force = inverse * (rows.T @ np.linalg.solve(gram, targets))
    return force, np.sum(lengths * force**2)


def way(lengths, time):
    """The position at a time of a mass of 1 kg from rest, by the forces on intervals."""
    begins = np.cumsum(lengths) - lengths
    part = np.clip(time - begins, 0, lengths)
    return part * (time - begins - part / 2) * (part > 0)


@pytest.mark.parametrize("hard", [True, False])
@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt", "mode_search", "auto"])
def test_a_waypoint_at_a_given_time_stays_at_its_node_as_the_duration_changes(hard, solver):
    """A disc passes (0.5, 0) at 0.5 s and ends at rest at (1, 0), at any time."""
    waypoint = {"body": "d", "time": 0.5, "quantity": "position", "target": [0.5, 0]}
    scene = saltus.Scene({
        "name": "s", "duration": 1.0, "steps": 20, "bodies": [{"name": "d", "radius": 0.1, "mass": 1.0, "position": [0, 0]}],
        "objective": {"terminal": [{"body": "d", "quantity": what, "target": target, "hard": True}
                                   for what, target in [("position", [1, 0]), ("velocity", [0, 0])]],
                      "via": [{**waypoint, "hard": True} if hard else {**waypoint, "weight": 100.0}],
                      "effort": 1.0, "duration": {"free": True, "min": 0.6, "max": 5, "weight": 2.0}},
        "control": {"bodies": ["d"], "initial": [[0, 0]]}, "optimize": "control"})
    run = saltus.solve(scene, "event", solver)
    assert run.termination == "converged" and run.certificate.verdict == "stationary", run.reason
    assert run.certificate.curvature["kind"] == "minimum"
    lengths = np.array(run.durations)
    behind = np.cumsum(lengths) > 0.5 * (1 + 1e-9)

    def least(duration):
        stretched = np.where(behind, lengths * (duration - 0.5) / lengths[behind].sum(), lengths)
        rows = np.array([way(stretched, duration), stretched, way(stretched, 0.5)])
        if hard:
            return quadratic_program(stretched, rows, np.array([1, 0, 0.5]))[1] + 2 * duration
        loss = lambda at: quadratic_program(stretched, rows, np.array([1, 0, at]))[1] + 100 * (at - 0.5)**2 + 2 * duration
        return scipy.optimize.minimize_scalar(loss, bracket=(0.3, 0.7), tol=1e-12).fun

    best = scipy.optimize.minimize_scalar(least, bounds=(0.7, 4), method="bounded", options={"xatol": 1e-9})
    assert_allclose([run.final_loss, lengths.sum()], [best.fun, best.x], rtol=1e-6)


@pytest.mark.parametrize("spins", [False, True])
@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt"])
def test_an_optimum_that_touches_beside_a_waypoint(spins, solver):
    """A disc that is drawn below the floor, and passes a waypoint, just touches the floor under a force that lifts it off. An
    impact would do a part of that for nothing, so that the loss falls with it."""
    disc = {"name": "d", "radius": 0.1, "mass": 1.0, "position": [0, 0.6], **({"inertia": "solid"} if spins else {})}
    ends = [{"body": "d", "quantity": "position", "target": [1.0, 0.6], "hard": True}]
    control = {"bodies": ["d"], "initial": [[0, 0]]}
    if spins:
        ends.append({"body": "d", "quantity": "angular_velocity", "min": 2.0, "max": 3.0})
        control = {"bodies": ["d"], "torque": ["d"], "initial": [[0, 0, 0]]}
    waypoint = {"body": "d", "time": 0.25, "quantity": "position", "target": [0.2, 0.5], "hard": True}
    drawn = {"body": "d", "quantity": "position", "target": [[0, 0, 0.6], [0.5, 0.5, -0.5], [1, 1, 0.6]], "weight": 100.0}
    scene = saltus.Scene({
        "name": "s", "duration": 1.0, "steps": 8, "bodies": [disc], "planes": [{"name": "g", "point": [0, 0], "normal": [0, 1]}],
        "contact": {"restitution": 0.0, "friction": 0.2}, "control": control, "optimize": "control",
        "objective": {"terminal": ends, "effort": 0.05, "running": [drawn], "via": [waypoint]}})
    run = saltus.solve(scene, "event", solver)
    assert run.certificate.verdict == "not_stationary" and "d-g just touches, and the loss falls with an event" in run.reason
    assert len(run.events) == 0 and run.control[4, 0, 1] > 1
    # Without impacts the motion is linear in the forces, of which the vertical ones keep it above the floor.
    lengths = np.full(8, 0.125)
    points, weights = np.polynomial.legendre.leggauss(3)
    times, parts = np.add.outer(np.arange(8), (points + 1) / 2).ravel() / 8, np.tile(weights, 8) / 16

    def least(start, end, passes, target):
        rows = np.array([way(lengths, time) for time in times])
        miss = start - np.interp(times, [0, 0.5, 1], target)
        square = 0.05 * np.diag(lengths) + 100 * (rows.T * parts) @ rows
        slope = 200 * (rows.T * parts) @ miss
        every = np.array([way(lengths, time) for time in np.linspace(0, 1, 801)])
        above = [] if start == 0 else [{"type": "ineq", "fun": lambda u: start + every @ u - 0.1, "jac": lambda u: every}]
        ends = [{"type": "eq", "fun": lambda u: start + way(lengths, 1.0) @ u - end, "jac": lambda u: way(lengths, 1.0)},
                {"type": "eq", "fun": lambda u: start + way(lengths, 0.25) @ u - passes, "jac": lambda u: way(lengths, 0.25)}]
        found = scipy.optimize.minimize(lambda u: u @ square @ u + slope @ u, np.zeros(8), jac=lambda u: 2 * square @ u + slope,
                                        constraints=ends + above, method="SLSQP", options={"ftol": 1e-13, "maxiter": 500})
        assert found.success, found.message
        return found.fun + 100 * parts @ miss**2

    best = least(0.0, 1.0, 0.2, [0, 0.5, 1]) + least(0.6, 0.6, 0.5, [0.6, -0.5, 0.6])
    turn = 0.05 * (0.05 * 2.0)**2 if spins else 0.0  # the effort of the torque that turns it, as of a force at the rim
    assert_allclose(run.final_loss, best + turn, rtol=1e-4)


@pytest.mark.parametrize("guess", [0.5, 0.2])
def test_a_kinked_optimum_is_named(guess):
    """The least value of max(p, 1 - p) is at its kink, p = 1/2; a smooth loss whose iterations end has none."""
    system = saltus.HybridSystem(
        states={"m": ["x"]}, parameters=["p"], flow={"m": lambda x, p: [np.maximum(p[0], 1 - p[0])]}
    )
    problem = saltus.HybridProblem(system, mode="m", initial=[0], parameters=[guess], duration=1.0)
    problem.costs = [saltus.cost(lambda x: x[0])]
    run = saltus.solve(problem, optimize=["p"], bounds={"p": (0, 1)})
    assert run.termination == "no_progress"
    assert "the loss has a kink at the solution" in run.reason
    np.testing.assert_allclose(run.parameters, 0.5, atol=1e-5)

    smooth = saltus.HybridSystem(
        states={"m": ["x"]}, parameters=["p"], flow={"m": lambda x, p: [np.cosh(3 * p[0] - 1) + 0.1 * np.sin(9 * p[0])]}
    )
    problem = saltus.HybridProblem(smooth, mode="m", initial=[0], parameters=[guess], duration=1.0)
    problem.costs = [saltus.cost(lambda x: x[0])]
    run = saltus.solve(problem, optimize=["p"], bounds={"p": (0, 1)}, iterations=2)
    assert run.termination == "iteration_limit"
    assert "kink" not in run.reason
