"""Scenes of discs as hybrid problems, beside the functions of scenes."""

import os
import pathlib
import pickle

import numpy as np
import pytest

import saltus

PROBLEMS = pathlib.Path(os.environ["SALTUS_SOURCE"]) / "problems"
SCENES = ["two_balls", "single_collision", "multiple_collisions", "ground_wall"]


def scene_of(name):
    return saltus.load_scene(PROBLEMS / f"{name}.yaml")


@pytest.mark.parametrize("name", SCENES)
def test_loss_and_gradient_are_those_of_the_scene(name):
    scene = scene_of(name)
    problem = saltus.hybrid_problem(scene)
    found, expected = saltus.loss_and_gradient(problem), saltus.loss_and_gradient(scene, contact="event")
    assert found.loss == pytest.approx(expected.loss, rel=1e-11)
    if scene.optimize == "control":
        by = np.ravel(expected.gradient["control"])
        assert np.allclose(np.ravel(found.gradient["control"]), by, rtol=0, atol=1e-10 * np.abs(by).max())


def test_optimum_and_certificate_are_those_of_the_scene():
    scene = scene_of("two_balls")
    found, expected = saltus.solve(saltus.hybrid_problem(scene)), saltus.solve(scene)
    assert found.termination == "converged"
    assert found.certificate.verdict in ("stationary", "global")
    assert found.loss == pytest.approx(expected.final_loss, rel=1e-6)
    assert [event[2] for event in found.events] == ["striker-target"]


def test_costs_at_events_are_new():
    problem = saltus.hybrid_problem(scene_of("two_balls"))
    plain = saltus.solve(problem)
    names = problem.system.states["flight"]
    vx = names.index("striker.vx")
    problem.costs = [*problem.costs, saltus.residuals(
        lambda x: [0.1 * x[vx], 0.1 * x[vx + 1]], at="event", guard="striker-target", before=True)]
    slow = saltus.solve(problem)
    assert slow.termination == "converged" and slow.certificate.verdict == "stationary"

    assert slow.loss > plain.loss
    assert slow.events[0][0] > plain.events[0][0]  # a slower striker strikes later


def test_waypoints_are_events_of_another_mode():
    scene = scene_of("two_balls").to_dict()
    scene["objective"]["via"] = [{"body": "striker", "quantity": "position", "time": 0.31, "target": [-1.8, -1.8], "weight": 2.0}]
    problem = saltus.hybrid_problem(scene)
    assert problem.system.modes == ["flight", "after waypoint 1"]
    motion = saltus.rollout(problem)
    assert [event[2] for event in motion.events][0] == "waypoint 1"
    known = saltus.solve(scene, solver="ceres_phases", iterations=1).initial_loss
    assert saltus.loss_and_gradient(problem).loss == pytest.approx(known, rel=1e-11)


def test_problems_are_pickled():
    problem = saltus.hybrid_problem(scene_of("two_balls"))
    assert saltus.rollout(pickle.loads(pickle.dumps(problem))).events == saltus.rollout(problem).events


def test_what_such_problems_do_not_have_is_refused():
    scene = scene_of("two_balls").to_dict()
    scene["table"] = {"friction": 0.1}
    with pytest.raises(ValueError, match="scene: found a table that discs slide on"):
        saltus.hybrid_problem(scene)
    with pytest.raises(TypeError):
        saltus.hybrid_problem(3)


def test_bounds_on_both_sides_of_an_impact():
    """At a bound the control goes on over an impact at the end of an interval. Intervals as they are: no control lowers the loss."""
    scene = saltus.Scene({
        "name": "bounded", "duration": 1.4848, "steps": 24,
        "bodies": [{"name": "striker", "radius": 0.1452, "mass": 1.0416, "position": [0, 0]},
                   {"name": "target", "radius": 0.0871, "mass": 0.6337, "position": [-0.1931, 1.1219]}],
        "planes": [{"name": "wall", "point": [0.0209, 1.534], "normal": [1.0009, -0.8838]}], "contact": {"restitution": 0.6797},
        "control": {"bodies": ["striker"], "initial": [[-0.52, 1.75]], "max": 1.75},
        "objective": {"terminal": [
            {"body": "target", "quantity": "position", "target": [-0.4464, 1.3408], "weight": 1},
            {"body": "striker", "quantity": "velocity", "target": [0, 0], "weight": 0.0245},
            {"body": "striker", "quantity": "velocity", "target": [-2.408, -2.6045], "weight": 0.6705}], "effort": 0.002},
        "optimize": "control"})
    problem = saltus.hybrid_problem(scene)
    run = saltus.solve(problem)
    assert run.termination == "converged", run.reason
    plan = saltus.hybrid_problem(scene)
    plan.start_from(run)
    found = saltus.loss_and_gradient(plan)
    inside = np.abs(run.control) < 1.75 - 1e-3
    assert inside.any()
    assert np.abs(np.asarray(found.gradient.control)[inside]).max() < 1e-5


def test_saddles_at_an_event_at_the_final_time_are_left():
    """The mass meets the wall at the final time, on the crest between two wells of y at -1 and 1, where the guess is symmetric."""
    system = saltus.HybridSystem(
        states={"m": ["x", "y", "vx", "vy"]}, controls=["ux", "uy"], flow={"m": lambda x, u: [x[2], x[3], u[0], u[1]]},
        guards={"m": {"wall": lambda x: 1 - x[0]}}, resets={"m": {"wall": lambda x: ("m", [x[0], x[1], -0.6 * x[2], x[3]])}})
    problem = saltus.HybridProblem(system, mode="m", initial=[0, 0, 0, 0], duration=1.0, control=np.tile([1.0, 0.0], (8, 1)))
    problem.costs = [saltus.residuals(lambda x: [x[0] - 1.3, x[1]**2 - 1], at="end"), saltus.effort(0.05)]
    run = saltus.solve(problem, solver="ceres_phases")
    assert run.termination == "converged", run.reason
    problem.start_from(run)
    loss = saltus.loss_and_gradient(problem).loss
    for change in ([0, 0.1], [0, -0.1], [0, 1e-2]):
        problem.control = np.asarray(run.control) + change
        assert saltus.loss_and_gradient(problem).loss > loss


def test_a_control_at_kinks_whose_loss_a_small_change_lowers_has_not_converged():
    """The striker is to stay beside the target, which it and the wall just touch: 60 random changes of the control are tried."""
    scene = saltus.Scene({
        "name": "stays", "duration": 1.4848, "steps": 24,
        "bodies": [{"name": "striker", "radius": 0.1452, "mass": 1.0416, "position": [0, 0]},
                   {"name": "target", "radius": 0.0871, "mass": 0.6337, "position": [-0.1931, 1.1219]}],
        "planes": [{"name": "wall", "point": [0.0209, 1.534], "normal": [1.0009, -0.8838]}], "contact": {"restitution": 0.6797},
        "control": {"bodies": ["striker"], "initial": [[-0.52, 1.7622]]},
        "objective": {"terminal": [
            {"body": "striker", "quantity": "position", "target": [-0.22105236849, 1.0978198102], "weight": 1},
            {"body": "target", "quantity": "position", "target": [-0.1931, 1.1219], "weight": 1.34130454598}], "effort": 0.002},
        "optimize": "control"})
    run = saltus.solve(scene)
    plan = saltus.hybrid_problem(scene)
    plan.control, plan.durations = np.reshape(run.control, (-1, 2)), run.durations
    batch, control = saltus.HybridBatch(plan, optimize=["control"], threads=1), np.ravel(run.control)
    changes = np.random.default_rng(0).normal(size=(60, control.size)) * np.sqrt(np.mean(control**2))
    for size in (1e-2, 3e-3, 1e-3):
        least = batch.loss(control + size * changes).min()
        assert run.termination != "converged" or least > run.exact_loss * (1 - 1e-4), (size, run.solver)
    assert run.exact_loss < 0.0407


def test_an_impact_at_the_final_time_beside_running_costs_has_a_certificate():
    """The ball is to be below the ground at the end and above it before: it falls until it meets it at the final time."""
    scene = saltus.Scene({
        "name": "fall", "duration": 1.0, "steps": 6, "gravity": [0, -1],
        "planes": [{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
        "bodies": [{"name": "ball", "radius": 0.1, "mass": 1, "position": [0, 0.6]}], "contact": {"restitution": 0.5},
        "control": {"bodies": ["ball"], "initial": [[0, 0.3]]},
        "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [0, -0.3], "weight": 1}], "effort": 0.05,
                      "running": [{"body": "ball", "quantity": "position", "target": [[0, 0, 0.5]], "weight": 0.5}]},
        "optimize": "control"})
    plan = saltus.hybrid_problem(scene)
    for run in (saltus.solve(scene), saltus.solve(plan)):
        assert run.termination == "converged", run.reason
        assert run.certificate.verdict == "stationary_on_grid"
    plan.start_from(run)
    batch, control = saltus.HybridBatch(plan, optimize=["control"], threads=1), np.ravel(run.control)
    for size in (1e-1, 1e-2, 1e-3):
        changes = size * np.random.default_rng(0).normal(size=(60, control.size))
        assert batch.loss(control + changes).min() > run.loss


def test_interior_points_take_waypoints_of_two_discs():
    """The event of a waypoint changes no state of the discs, which are parts of the problem."""
    scene = saltus.Scene(
        name="via", duration=1.0, steps=16, optimize="control", control={"bodies": ["a"], "initial": [[4, 0.3]]},
        bodies=[{"name": "a", "radius": 0.1, "mass": 1.0, "position": [-1, 0]},
                {"name": "b", "radius": 0.15, "mass": 0.8, "position": [-0.3, 0.05]}],
        objective={"terminal": [{"body": "b", "quantity": "position", "target": [0.15, 0.25], "weight": 30}], "effort": 0.02,
                   "via": [{"body": "a", "time": 0.25, "quantity": "position", "target": [-0.9, 0.1], "weight": 2}]})
    problem = saltus.hybrid_problem(scene)
    inside, phases = saltus.solve(problem, solver="ipopt"), saltus.solve(problem, solver="ceres_phases")
    assert inside.termination == phases.termination == "converged"
    assert inside.loss == pytest.approx(phases.loss, abs=1e-8)


def test_a_maximum_along_a_parameter_that_is_zero_is_left():
    """A peg in the way of the ball: by symmetry the loss is stationary there, and falls as the peg moves to either side."""
    scene = saltus.Scene(
        name="head_on", duration=1.0, steps=8, contact={"restitution": 0.9},
        bodies=[{"name": "ball", "radius": 0.1, "mass": 1.0, "position": [-0.5, 0], "velocity": [2, 0]},
                {"name": "peg", "radius": 0.2, "fixed": True, "position": [0.5, 0]}],
        control={"bodies": ["ball"], "initial": [[0, 0]]},
        objective={"terminal": [{"body": "ball", "quantity": "velocity", "target": [1.0, 0]}], "effort": 50.0},
        optimize=["control", {"parameter": "position.peg.y", "min": -0.25, "max": 0.25}])
    problem = saltus.hybrid_problem(scene)
    at_start = saltus.loss_and_gradient(problem).loss
    run = saltus.solve(problem)
    assert run.termination == "converged"
    assert run.loss < 0.5 * at_start
    assert abs(run.parameters[0]) > 0.1
