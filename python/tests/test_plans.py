"""Runs as plans: the intervals, durations and initial states of solutions are kept by what follows or starts from them."""

import numpy as np
import pytest
from conftest import SOURCE
from numpy.testing import assert_allclose, assert_array_equal

import saltus

HOCKEY = {
    "name": "hockey", "duration": 1.5, "steps": 30,
    "bodies": [
        {"name": "striker", "radius": 0.08, "mass": 0.3, "position": [0.3, -0.2]},
        {"name": "puck", "radius": 0.05, "mass": 0.1, "position": [0.9, 0.1], "velocity": [-0.3, -0.1]},
    ],
    "contact": {"restitution": 0.9}, "control": {"bodies": ["striker"], "initial": [[3, 1]], "max": 4.0},
    "objective": {
        "terminal": [{"body": "puck", "quantity": "position", "target": [2.0, 0.15], "hard": True}],
        "effort": 0.01, "duration": {"free": True, "min": 0.3, "max": 3, "weight": 1.0},
    },
    "optimize": "control",
}


@pytest.fixture(scope="module")
def hockey():
    scene = saltus.Scene(HOCKEY)
    return scene, saltus.solve(scene, "event", "ceres_phases", iterations=200)


def test_plan_of_a_run_with_a_free_duration(hockey):
    scene, run = hockey
    small = 1e-16 * np.eye(8)
    runs = saltus.noisy_runs(scene, small, plan=run, samples=4)
    # The puck ends where the solution says, and where the hard term asks for.
    assert_allclose(runs.mean[4:6], [2.0, 0.15], atol=1e-6)
    # The control knows its intervals; as a plain array it is refused, as its duration is not known.
    assert_array_equal(saltus.noisy_runs(scene, small, plan=run.control, samples=4).mean, runs.mean)
    plain = np.array(run.control)
    durations = saltus.noisy_runs(scene, small, plan=plain, durations=run.durations, samples=4)
    assert_array_equal(durations.mean, runs.mean)
    with pytest.raises(ValueError, match="duration is not known"):
        saltus.noisy_runs(scene, small, plan=plain, samples=4)
    with pytest.raises(ValueError, match=r"plan: found shape \(30, 1, 2\), expected \(29, 1, 2\)"):
        saltus.propagate(scene, small, plan=plain, durations=run.durations[:-1])
    regulator = saltus.track(scene, np.eye(8), 0.1 * np.eye(2), np.eye(8), plan=run)
    assert len(regulator.gains) == len(run.durations)


def test_controls_on_other_intervals_are_refused(hockey):
    scene, run = hockey
    with pytest.raises(ValueError, match="different lengths"):
        saltus.Simulation(scene).loss(run.control)
    two_balls = saltus.load_scene(SOURCE / "problems" / "two_balls.yaml").replace(steps=6)
    phases = saltus.solve(two_balls, "event", "ceres_event")
    assert np.ptp(phases.durations) > 1e-3
    for refused in (saltus.rollout, saltus.loss_and_gradient, saltus.linearize):
        with pytest.raises(ValueError, match="different lengths|found shape"):
            refused(two_balls, control=phases.control)
    # A plan is the solution's own motion: its loss is the exact loss.
    errors = 1e-18 * np.eye(8)
    runs = saltus.noisy_runs(two_balls, errors, plan=phases, samples=2)
    assert_allclose(runs.mean, np.ravel(phases.exact_final_state), atol=1e-8)
    # Copies and sums are on the same intervals; parts are not, and an array that is asked for is plain.
    for same in (phases.control.copy(), phases.control[:], phases.control + 0.1, 2 * phases.control):
        with pytest.raises(ValueError, match="different lengths.*np.array"):
            saltus.rollout(two_balls, control=same)
    assert phases.control[:3].durations is None and phases.control[0].durations is None
    assert not hasattr(np.array(phases.control), "durations")


def test_start_from_a_run(hockey):
    scene, run = hockey
    again = saltus.solve(scene, "event", "ceres_phases", start=run, iterations=50)
    assert again.exact_loss <= run.exact_loss + 1e-8
    assert again.iterations < run.iterations
    with pytest.raises(TypeError, match="start: found ndarray, expected a Run"):
        saltus.solve(scene, "event", "ceres_phases", start=np.zeros((30, 1, 2)))


def test_initial_states_of_a_run():
    """A run has the velocities of all discs, and the positions where they are optimised; the rest is the scene's."""
    discs = [{"name": "d", "radius": 0.1, "mass": 1, "position": [0, 1], "velocity": [1, 1]},
             {"name": "e", "radius": 0.1, "mass": 1, "position": [-5, 1], "velocity": [0, 1]}]
    for optimize in ("velocity", "position"):
        scene = saltus.Scene(
            name="throw", duration=1.0, steps=20, gravity=[0, -9.8], bodies=discs, optimize=optimize, free=["d"],
            objective={"terminal": [{"body": "d", "quantity": "position", "target": [2, 0.5]}]})
        run = saltus.solve(scene, "event", "ceres_lm")
        runs = saltus.noisy_runs(scene, 1e-18 * np.eye(8), plan=run, samples=2)
        assert_allclose(runs.mean[:2], [2, 0.5], atol=1e-5)
        for key in ("velocity", optimize):
            other = scene.replace(bodies=[discs[0], {**discs[1], key: [-5, 2]}])
            with pytest.raises(ValueError, match=f"the {key} of e is not the scene's"):
                saltus.noisy_runs(other, 1e-18 * np.eye(8), plan=run, samples=2)


def ball(**changes):
    system = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["f"], parameters=["g", "e"],
        flow={"flight": lambda t, x, u, p: [x[1], -p[0] + u[0]]}, guards={"flight": {"ground": lambda t, x, p: x[0]}},
        resets={"flight": {"ground": lambda t, x, p: ("flight", [0, -p[1] * x[1]])}})
    given = dict(mode="flight", initial=[4, 0], parameters=[9.8, 0.7], duration=1.0, control=np.zeros((7, 1)),
                 costs=[saltus.terminal([1, 0], weight=100), saltus.effort(1 / 32)])
    return saltus.HybridProblem(system, **{**given, **changes})


def test_durations_of_a_hybrid_problem():
    # Two pushes of 0.25 and 0.75 s from rest, far above the ground: v = u1/4 + 3 u2/4, y = u1 (1/32 + 3/16) + u2 9/32.
    problem = ball(initial=[50, 0], parameters=[0, 0.7], control=[[2], [-4]], durations=[0.25, 0.75])
    final = saltus.rollout(problem).final
    assert_allclose(final, [50 + 2 * (1 / 32 + 3 / 16) - 4 * 9 / 32, 0.5 - 3], rtol=1e-14)
    assert_allclose(ball(initial=[50, 0], parameters=[0, 0.7], control=[[2], [-4]], durations=[0.25, 0.75],
                         duration=None).duration, 1.0)
    gradient = saltus.final_derivatives(problem).by_control
    assert_allclose(np.ravel(gradient[1]), [0.25, 0.75], rtol=1e-12)
    with pytest.raises(ValueError, match=r"durations: found shape \(3,\), expected \(2,\)"):
        ball(control=[[2], [-4]], durations=[0.25, 0.5, 0.25])
    with pytest.raises(ValueError, match="durations: found a sum of 1.5, expected the duration, 1"):
        ball(control=[[2], [-4]], durations=[0.75, 0.75])
    with pytest.raises(ValueError, match="expected finite numbers > 0"):
        ball(control=[[2], [-4]], durations=[0, 1])


def test_hybrid_problem_from_a_run():
    problem = ball()
    run = saltus.solve(problem, solver="ceres_phases")
    assert np.ptp(run.durations) > 1e-3
    following = ball(control=run.control, durations=run.durations)
    assert_allclose(saltus.rollout(following).final, run.final, atol=1e-9)
    # The control brings its intervals, too.
    problem.control = run.control
    assert_allclose(saltus.rollout(problem).final, run.final, atol=1e-9)
    other = ball()
    other.start_from(run)
    assert_allclose(saltus.rollout(other).final, run.final, atol=1e-9)
    runs = saltus.noisy_runs(ball(), 1e-18 * np.eye(2), plan=run, samples=2)
    assert_allclose(runs.mean, run.final, atol=1e-6)
    again = saltus.solve(ball(), solver="ceres_phases", start=run)
    assert again.loss <= run.loss * (1 + 1e-9)
    with pytest.raises(TypeError, match="run: found dict, expected a HybridRun"):
        other.start_from({})


def test_a_point_goal_that_becomes_a_region():
    """From the optimum of a point goal, the optimum of a region around it is found; few iterations do not claim it."""
    restitution, striker, puck, reach = 0.9, 0.3, 0.1, 0.13

    def hit(t, x, p):
        n = np.array([x[4] - x[0], x[5] - x[1]]) / np.sqrt((x[4] - x[0]) ** 2 + (x[5] - x[1]) ** 2)
        j = -(1 + restitution) * (n[0] * (x[6] - x[2]) + n[1] * (x[7] - x[3])) / (1 / striker + 1 / puck)
        return "play", [x[0], x[1], x[2] - j * n[0] / striker, x[3] - j * n[1] / striker,
                        x[4], x[5], x[6] + j * n[0] / puck, x[7] + j * n[1] / puck]

    system = saltus.HybridSystem(
        states={"play": ["sx", "sy", "svx", "svy", "px", "py", "pvx", "pvy"]}, controls=["fx", "fy"],
        flow={"play": lambda t, x, u, p: [x[2], x[3], u[0] / striker, u[1] / striker, x[6], x[7], 0, 0]},
        guards={"play": {"hit": lambda t, x, p: (x[4] - x[0]) ** 2 + (x[5] - x[1]) ** 2 - reach**2,
                         "top": lambda t, x, p: 0.45 - x[5]}},
        resets={"play": {"hit": hit, "top": lambda t, x, p: ("play", [*x[:7], -restitution * x[7]])}})
    problem = saltus.HybridProblem(system, mode="play", initial=[0.3, -0.2, 0, 0, 0.9, 0.1, -0.3, -0.1], duration=0.9,
                                   control=np.tile([1.0, 0.5], (40, 1)))

    def solve(goal, role, **options):
        problem.costs = [saltus.effort(0.01), saltus.final_time(1.0), saltus.residuals(goal, role=role, name="goal"),
                         saltus.residuals(lambda x: [x[2] ** 2 + x[3] ** 2 - 0.09], role="inequality", name="slow")]
        return saltus.solve(problem, solver="ceres_phases", optimize=["control", "duration"],
                            bounds={"fx": (-4, 4), "fy": (-4, 4), "duration": (0.3, 3)}, **options)

    by_cushion = ["hit", "top"]  # a straight shot at the edge has a lower loss
    edge = solve(lambda x: [2 - x[4], x[5] - 0.15], "equality", sequence=by_cushion)
    middle = solve(lambda x: [2 - x[4], x[5]], "equality", sequence=by_cushion)
    assert middle.loss > edge.loss + 0.01
    problem.start_from(middle)
    region = lambda x: [2 - x[4], x[5] - 0.15, -0.15 - x[5]]
    assert solve(region, "inequality", iterations=2).termination == "iteration_limit"
    run = solve(region, "inequality")
    assert run.termination == "converged" and run.certificate.verdict == "stationary"
    assert run.loss < edge.loss * (1 + 1e-6)  # by the cushion, or by the straight shot
    assert_allclose(run.final[4:6], [2, 0.15], atol=1e-6)


def test_a_free_duration_of_a_hybrid_run():
    problem = ball(costs=[saltus.terminal([1, 0], weight=100), saltus.effort(1 / 32), saltus.final_time(0.1)])
    run = saltus.solve(problem, solver="ceres_phases", optimize=["control", "duration"])
    assert abs(run.duration - 1) > 1e-3
    problem.start_from(run)
    assert problem.duration == run.duration
    assert_allclose(saltus.rollout(problem).final, run.final, atol=1e-9)


def test_unknown_attributes_are_refused():
    problem = ball()
    for of, name in ((problem, "cost"), (problem.system, "guard"), (problem.costs[0], "weight")):
        with pytest.raises(AttributeError, match=f"has no attribute '{name}'"):
            setattr(of, name, [])
    with pytest.raises(AttributeError):
        saltus.Simulation(saltus.Scene(HOCKEY).replace(optimize="control")).control = None


def discs(places):
    """Discs at rest, and one that comes along x."""
    return saltus.Scene(
        name="discs", duration=1.0, steps=20, objective={"terminal": []}, optimize="none",
        bodies=[{"name": n, "radius": 0.1, "mass": 1, "position": p, "velocity": [float(n == "s"), 0]}
                for n, p in places.items()])


TIE = {"s": [-0.5, 0], "a": [0, 0.1], "b": [0, -0.1]}
ROW = {"s": [-0.75, 0], "a": [-0.2, 0], "b": [0, 0]}
ASIDE = {"s": [-0.5, 0.5], "a": [0, 0.1], "b": [0, -0.1]}


def test_impacts_at_the_same_time_warn():
    found = saltus.propagate(discs(TIE), 1e-6 * np.eye(12))
    assert found.change_probability >= 0.5
    assert "comes before" in found.warning or "falls below zero" in found.warning
    assert "the order of the impacts of s, a and b" in found.remark


@pytest.mark.parametrize("places", [TIE, ROW, ASIDE])
def test_discs_that_touch_count(places):
    """Half of all errors push them into each other at once, others later."""
    scene, P = discs(places), 1e-8 * np.eye(12)
    found, runs = saltus.propagate(scene, P), saltus.noisy_runs(scene, P, samples=1000)
    assert 300 < runs.otherwise <= 1000 * found.change_probability
    at_once = [risk for risk in found.risks if risk[:2] == ("the gap of a and b falls below zero", 0.0)]
    assert [probability for _, _, probability in at_once] == [0.5]


def test_discs_that_touch_without_errors_of_their_own():
    P = np.diag([1e-8] * 4 + [0] * 8)
    assert saltus.propagate(discs(ROW), P).change_probability < 1e-6
    assert saltus.noisy_runs(discs(ROW), P, samples=100).otherwise == 0


def test_a_wall_that_ends_is_not_touched_beside_its_end():
    gate = saltus.load_scene(SOURCE / "problems" / "carrom_gate.yaml")
    found = saltus.propagate(gate, 1e-10 * np.eye(8))
    assert found.risks == [] and saltus.noisy_runs(gate, 1e-10 * np.eye(8), samples=50).otherwise == 0


@pytest.mark.parametrize("from_start", [False, True])
@pytest.mark.parametrize("wall", [False, True])
def test_contacts_without_a_force_count(wall, from_start):
    """Behind an inelastic impact, or from the start, any disturbance separates the pair or pushes it together. Errors of the
    initial state do neither behind the impact."""
    bodies = [{"name": "disc", "radius": 0.1, "mass": 1, "position": [0, 0.1 if from_start else 0.3],
               "velocity": [0.5, 0 if from_start else -1]},
              {"name": "other", "radius": 0.1, "mass": 2, "position": [5, 1] if wall else [0, -0.1], "velocity": [0.5, 0]}]
    scene = saltus.Scene({
        "name": "touching", "duration": 1, "steps": 20, "bodies": bodies, "contact": {"restitution": 0},
        "planes": [{"name": "ground", "point": [0, 0], "normal": [0, 1]}] if wall else [],
        "control": {"bodies": ["disc"], "initial": [[0, 0]]}, "optimize": "control",
        "objective": {"terminal": [{"body": "disc", "quantity": "position", "target": [1, 0]}]}})
    samples = 400
    for noise in ({"control": 1e-6 * np.eye(2)}, {"process": 1e-8 * np.eye(8)}):
        covariance = saltus.propagate(scene, **noise)
        share = saltus.noisy_runs(scene, **noise, samples=samples).otherwise / samples
        assert share > 0.2
        assert covariance.change_probability >= share - 3 * np.sqrt(0.25 / samples)
        assert f"the gap of disc and {'ground' if wall else 'other'} falls below zero" in covariance.warning
    if not from_start:
        initial = np.diag([1e-8] * 4 + [0] * 4)
        assert saltus.propagate(scene, initial).change_probability == 0
        assert saltus.noisy_runs(scene, initial, samples=50).otherwise == 0


def test_durations_that_change_count():
    """x' = u from 0: x(1) is the sum of u over the lengths of its intervals."""
    system = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda u: u})
    problem = saltus.HybridProblem(system, mode="m", initial=[0], duration=1.0, control=[[1.0], [3.0]], costs=[saltus.terminal([0.0])])
    for durations in (None, [0.2, 0.8], [0.8, 0.2], None):
        problem.durations = durations
        lengths = np.array([0.5, 0.5] if durations is None else durations)
        found = saltus.loss_and_gradient(problem)
        end = lengths @ [1, 3]
        assert_allclose(found.loss, end**2, rtol=1e-12)
        assert_allclose(np.ravel(found.gradient.control), 2 * end * lengths, rtol=1e-12)


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt", "mode_search", "ceres_lm", "auto"])
def test_solvers_keep_durations_without_events(solver):
    """x' = u - x with three intervals: a linear least squares problem, which NumPy solves."""
    system = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda x, u: [u[0] - x[0]]})
    lengths = np.array([0.1, 0.2, 0.7])
    problem = saltus.HybridProblem(system, mode="m", initial=[1], duration=1.0, control=np.zeros((3, 1)), durations=lengths,
                                   costs=[saltus.terminal([1.0], weight=5), saltus.effort(1.0)])
    run = saltus.solve(problem, solver=solver)
    ends = np.cumsum(lengths)
    by_control = np.exp(ends - 1) - np.exp(ends - lengths - 1)  # of x(1)
    rows = np.vstack([np.sqrt(5) * by_control, np.diag(np.sqrt(lengths))])
    right = np.array([np.sqrt(5) * (1 - np.exp(-1)), 0, 0, 0])
    best = np.linalg.lstsq(rows, right, rcond=None)[0]
    assert_allclose(run.durations, lengths, rtol=1e-12)
    assert_allclose(np.ravel(run.control), best, rtol=1e-6)
    assert_allclose(run.loss, np.sum((rows @ best - right) ** 2), rtol=1e-9)


@pytest.mark.parametrize("solver", ["ceres_lm", "ceres_lbfgs"])
def test_a_start_at_an_optimum_is_recognised(solver):
    """From an optimum steps are below the rounding of the loss; the certificate tells that it is one."""
    ball = saltus.HybridSystem(
        states={"f": ["y", "v"]}, controls=["f"], parameters=["e"], flow={"f": lambda x, u: [x[1], -9.81 + u[0]]},
        guards={"f": {"g": lambda x: x[0]}}, resets={"f": {"g": lambda x, p: ("f", [0, -p[0] * x[1]])}})
    problem = saltus.HybridProblem(ball, mode="f", initial=[1, 0], parameters=[0.7], duration=1.6, control=np.zeros((1, 1)),
                                   costs=[saltus.terminal([0.3, 0.0], weight=10), saltus.effort(0.1)])
    run = saltus.solve(problem, solver="ceres_phases")
    problem.start_from(run)
    again = saltus.solve(problem, solver=solver)
    assert again.termination == "converged" and again.certificate.curvature["kind"] == "minimum"
    assert_allclose(again.loss, run.loss, rtol=1e-12)
