"""Goal regions and limits of the speed: one game of air hockey as a scene file, as a Scene and as a HybridSystem."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import saltus

AIR_HOCKEY = """
name: air_hockey
duration: 0.5
steps: 40
bodies:
  - {name: striker, radius: 0.08, mass: 0.3, position: [0.3, -0.2]}
  - {name: puck, radius: 0.05, mass: 0.1, position: [0.9, 0.1], velocity: [-0.3, -0.1]}
  - {name: post, radius: 0.12, fixed: true, position: [1.4, 0.0]}
planes:
  - {name: top, point: [0, 0.5], normal: [0, -1]}
  - {name: bottom, point: [0, -0.5], normal: [0, 1]}
  - {name: back, point: [0, 0], normal: [1, 0]}
contact: {restitution: 0.9}
control: {bodies: [striker], initial: [[3, 1]], max: 4.0}
objective:
  terminal:
    - {body: puck, quantity: position, min: [2.0, -0.15], max: [null, 0.15]}
  limits:
    - {body: striker, speed: {max: 0.3}, at: end}
  effort: 0.01
  duration: {free: true, min: 0.3, max: 3, weight: 1.0}
no_contact: [[puck, post], [striker, post]]
optimize: control
"""
# The optimum of the hybrid system below on 40 intervals, by ceres_phases and by ipopt, from any of three guesses.
LOSS, DURATION = 0.556028, 0.48805


def as_a_file(folder):
    path = folder / "air_hockey.yaml"
    path.write_text(AIR_HOCKEY, encoding="utf-8")
    return saltus.load_scene(path)


def in_python():
    goal = saltus.terminal(min=[2.0, -0.15], max=[None, 0.15], body="puck")
    return saltus.Scene(
        name="air_hockey", duration=0.5, steps=40, contact={"restitution": 0.9},
        bodies=[{"name": "striker", "radius": 0.08, "mass": 0.3, "position": [0.3, -0.2]},
                {"name": "puck", "radius": 0.05, "mass": 0.1, "position": [0.9, 0.1], "velocity": [-0.3, -0.1]},
                {"name": "post", "radius": 0.12, "fixed": True, "position": [1.4, 0]}],
        planes=[{"name": "top", "point": [0, 0.5], "normal": [0, -1]}, {"name": "bottom", "point": [0, -0.5], "normal": [0, 1]},
                {"name": "back", "point": [0, 0], "normal": [1, 0]}],
        control={"bodies": ["striker"], "initial": [[3, 1]], "max": 4.0},
        objective={"terminal": [goal], "limits": [{"body": "striker", "speed": {"max": 0.3}, "at": "end"}], "effort": 0.01,
                   "duration": {"free": True, "min": 0.3, "max": 3, "weight": 1}},
        no_contact=[["puck", "post"], ["striker", "post"]], optimize="control")


def as_a_hybrid_system(duration=0.9, force=(1, 0.5)):
    m, n, e = 0.3, 0.1, 0.9

    def strike(x):
        dx, dy = x[4] - x[0], x[5] - x[1]
        j = -(1 + e) * ((x[6] - x[2]) * dx + (x[7] - x[3]) * dy) / (dx * dx + dy * dy) / (1 / m + 1 / n)
        return "play", [x[0], x[1], x[2] - j / m * dx, x[3] - j / m * dy, x[4], x[5], x[6] + j / n * dx, x[7] + j / n * dy]

    system = saltus.HybridSystem(
        states={"play": ["sx", "sy", "svx", "svy", "px", "py", "pvx", "pvy"]}, controls=["fx", "fy"],
        flow={"play": lambda x, u: [x[2], x[3], u[0] / m, u[1] / m, x[6], x[7], 0, 0]},
        guards={"play": {"strike": lambda x: (x[4] - x[0])**2 + (x[5] - x[1])**2 - 0.13**2, "top": lambda x: 0.45 - x[5]}},
        resets={"play": {"strike": strike, "top": lambda x: ("play", [*(x[i] for i in range(7)), -e * x[7]])}})
    return saltus.HybridProblem(
        system, mode="play", initial=[0.3, -0.2, 0, 0, 0.9, 0.1, -0.3, -0.1], duration=duration, control=np.tile(force, (40, 1)),
        costs=[saltus.effort(0.01), saltus.final_time(1.0),
               saltus.terminal(min=[None] * 4 + [2, -0.15, None, None], max=[None] * 5 + [0.15, None, None]),
               saltus.residuals(lambda xT: [xT[2]**2 + xT[3]**2 - 0.3**2], role="inequality")],
        optimize=["control", "duration"], bounds={"fx": (-4, 4), "fy": (-4, 4), "duration": (0.3, 3)})


def test_a_file_and_a_dict_are_the_same_scene(tmp_path):
    assert as_a_file(tmp_path) == in_python()
    assert saltus.Scene(in_python().to_dict()) == in_python()


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt"])
def test_the_game_has_one_optimum_however_it_is_stated(solver, tmp_path):
    if solver not in saltus.solvers():
        pytest.skip(f"{solver} is not built")
    hybrid = saltus.solve(as_a_hybrid_system(), solver=solver)
    assert hybrid.termination == "converged" and hybrid.certificate.verdict == "stationary"
    assert_allclose([hybrid.loss, hybrid.duration], [LOSS, DURATION], rtol=1e-5)
    for scene in (as_a_file(tmp_path), in_python()):
        run = saltus.solve(scene, solver=solver)
        assert run.termination == "converged", run.reason
        assert_allclose([run.final_loss, sum(run.durations)], [LOSS, DURATION], rtol=1e-5)
        assert [(event["a"], event["b"]) for event in run.events] == [("striker", "puck"), ("puck", "top")]
        striker, puck = np.asarray(run.final_state)[:2]
        assert_allclose(puck[:2], [2, 0.15], atol=1e-7)
        assert_allclose(np.hypot(*striker[2:4]), 0.3, atol=1e-7)


@pytest.mark.parametrize("duration, force", [(0.5, (3, 1)), (1.5, (1, 0.5))])
def test_a_hybrid_system_reaches_its_goal_from_other_guesses(duration, force):
    run = saltus.solve(as_a_hybrid_system(duration, force), sequence=["strike", "top"])
    assert run.termination == "converged", run.reason
    assert_allclose([run.loss, run.duration], [LOSS, DURATION], rtol=1e-5)


@pytest.mark.parametrize("arguments, term", [
    ({"target": [2, None], "hard": True}, {"min": [2, None], "max": [2, None]}),
    ({"target": [2, 1], "hard": True}, {"target": [2, 1], "hard": True}),
    ({"target": [2, 1], "weight": 3}, {"target": [2, 1], "weight": 3}),
    ({"target": 0.5, "quantity": "angle", "hard": True}, {"target": 0.5, "hard": True}),
    ({"max": 0.5, "quantity": "angle"}, {"max": 0.5}),
    ({"min": np.array([2, -1])}, {"min": [2, -1]}),
])
def test_terms_of_scenes_have_the_keys_of_scene_files(arguments, term):
    quantity = arguments.get("quantity", "position")
    assert saltus.terminal(**arguments, body="puck") == {"body": "puck", "quantity": quantity, **term}


@pytest.mark.parametrize("arguments, message", [
    ({"target": [1, 2], "quantity": "position"}, "quantity: found 'position' without a body"),
    ({"target": [1, 2], "body": "puck", "mode": "play"}, "mode: found 'play' beside a body"),
    ({"target": [1, None], "body": "puck"}, "only a hard target of a scene leaves a component out"),
    ({"target": [1, 2], "min": [0, 0], "body": "puck"}, "min and max: found them beside a target"),
    ({"target": [1, 2], "hard": True, "weight": 2, "body": "puck"}, "weight: found one of a hard target"),
])
def test_wrong_terms_of_scenes_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        saltus.terminal(**arguments)


def test_a_box_is_pushed_to_the_edge_of_its_goal():
    """From rest without forces but the push, in four steps: the least integral of |u|^2 for x(1) = d is m^2 d^2 / sum h (1 - t)^2."""
    data = {"name": "push", "duration": 1, "steps": 4, "contact": {"restitution": 0},
            "bodies": [{"name": "box", "box": [0.1, 0.1], "mass": 2, "position": [0, 0], "velocity": [0, 0.25]}], "planes": [],
            "control": {"bodies": ["box"], "initial": [[1, 0, 0]]},
            "objective": {"terminal": [saltus.terminal(min=[1.5, None], max=[2, 1], body="box")], "effort": 0.1},
            "optimize": "control"}
    run = saltus.solve(saltus.load_bodies(data), solver="ceres_phases")
    assert run.termination == "converged", run.reason
    assert_allclose(run.final[:2], [1.5, 0.25], atol=1e-6)
    assert_allclose(run.loss, 0.1 * 4 * 1.5**2 / (0.25 * sum(np.array([0.875, 0.625, 0.375, 0.125])**2)), rtol=1e-6)
    with pytest.raises(saltus.SceneError, match="found min above max"):
        saltus.load_bodies({**data, "objective": {"terminal": [saltus.terminal(min=[3, None], max=[2, 1], body="box")]}})
