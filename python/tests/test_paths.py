"""Prescribed motions of discs and planes in scenes."""

import pickle

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

import saltus

E, RADIUS = 0.9, 0.1
TIMES = np.linspace(0, 2, 17)
WALL = 2.0 + 0.3 * np.sin(4.0 * TIMES)


def between_walls(**keys):
    """A ball between a wall that rests and one that oscillates."""
    return {
        "name": "between_walls", "duration": 2.0, "steps": 40, "optimize": "velocity", "contact": {"restitution": E},
        "bodies": [{"name": "ball", "radius": RADIUS, "mass": 1.0, "position": [1, 0], "velocity": [2.3, 0.4]}],
        "planes": [{"name": "left", "point": [0, 0], "normal": [1, 0]},
                   {"name": "right", "normal": [-1, 0],
                    "motion": {"times": TIMES.tolist(), "positions": [[x, 0] for x in WALL]}}],
        "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [1, 0]},
                                   {"body": "ball", "quantity": "velocity", "target": [0, 0], "weight": 0.1}]}, **keys}


def bounce(v0, friction=0.0):
    """Simulates the ball in x: state, its derivative by the initial [x, vx], and the times and walls of impacts."""
    wall = CubicSpline(TIMES, WALL)
    x, v, now, events, by = 1.0, v0, 0.0, [], np.eye(2)
    while True:
        def gap(t, x=x, v=v, now=now):
            return wall(t) - RADIUS - x - v * (t - now)

        grid = np.union1d(np.linspace(now, 2, 4001), TIMES[TIMES > now])
        right = next((brentq(gap, a, b, xtol=1e-15, rtol=1e-15) for a, b in zip(grid, grid[1:])
                      if gap(b) < 0 and a > now), np.inf)
        left = now + (RADIUS - x) / v if v < 0 else np.inf
        hit = min(left, right)
        if hit >= 2:
            return np.array([x + v * (2 - now), v]), np.array([[1, 2 - now], [0, 1]]) @ by, events
        by = np.array([[1, hit - now], [0, 1]]) @ by
        x += v * (hit - now)
        u, a = (wall(hit, 1), wall(hit, 2)) if right < left else (0.0, 0.0)
        after = u - E * (v - u)
        # dt = -dx / (v - u), with which the state behind the impact, at the old time, changes by the saltation matrix.
        shift = -1 / (v - u)
        by = np.array([[1 + (v - after) * shift, 0], [(1 + E) * a * shift, -E]]) @ by
        v, now = after, hit
        events.append((hit, "right" if right < left else "left"))


def test_a_ball_between_a_wall_at_rest_and_an_oscillating_one():
    motion = saltus.rollout(between_walls())
    state, by, events = bounce(2.3)
    assert len(events) >= 3 and {"left", "right"} == {name for _, name in events}
    assert [event["b"] for event in motion.events] == [name for _, name in events]
    assert np.allclose([event["time"] for event in motion.events], [time for time, _ in events], rtol=0, atol=1e-10)
    assert np.allclose(motion.states[-1][0][[0, 2]], state, rtol=0, atol=1e-10)
    found = saltus.loss_and_gradient(between_walls()).gradient
    loss_by = np.array([2 * (state[0] - 1), 0.2 * state[1]]) @ by
    assert found["position"][0][0] == pytest.approx(loss_by[0], abs=1e-10 * max(1, abs(loss_by[0])))
    assert found["velocity"][0][0] == pytest.approx(loss_by[1], abs=1e-10 * max(1, abs(loss_by[1])))


PADDLE = np.array([[0.0, -0.5], [0.3, -0.1], [0.1, 0.2], [-0.2, -0.1], [0.0, -0.4]])


def paddled(**keys):
    """A ball falls on a paddle that swings upwards."""
    return {
        "name": "paddled", "duration": 1.0, "steps": 50, "gravity": [0, -9.81], "optimize": "velocity",
        "contact": {"restitution": 0.8},
        "bodies": [{"name": "ball", "radius": 0.1, "mass": 0.4, "position": [0.05, 1.2], "velocity": [0.1, 0]},
                   {"name": "paddle", "radius": 0.15,
                    "path": {"times": [0, 0.25, 0.5, 0.75, 1.0], "positions": PADDLE.tolist()}}],
        "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [1, 1]}]}, **keys}


def paddle_ball(vx):
    """Returns the state of the ball at the end, and the times of its impacts."""
    path = CubicSpline([0, 0.25, 0.5, 0.75, 1.0], PADDLE)
    p, v, now, times, g = np.array([0.05, 1.2]), np.array([vx, 0.0]), 0.0, [], np.array([0, -9.81])

    def at(t):
        s = t - now
        return p + s * v + 0.5 * s * s * g

    while True:
        grid = np.linspace(now + 1e-9, 1.0, 4001)
        gaps = [np.linalg.norm(at(t) - path(t)) - 0.25 for t in grid]
        step = next((i for i in range(4000) if gaps[i] > 0 >= gaps[i + 1]), None)
        if step is None:
            return np.concatenate([at(1.0), v + (1.0 - now) * g]), times
        hit = brentq(lambda t: np.linalg.norm(at(t) - path(t)) - 0.25, grid[step], grid[step + 1], xtol=1e-15, rtol=1e-15)
        p, v, now = at(hit), v + (hit - now) * g, hit
        n = (p - path(hit)) / 0.25
        v = v - 1.8 * (n @ (v - path(hit, 1))) * n
        times.append(hit)


def test_a_ball_on_a_paddle():
    motion = saltus.rollout(paddled())
    state, times = paddle_ball(0.1)
    assert len(times) >= 1
    assert np.allclose([event["time"] for event in motion.events], times, rtol=0, atol=1e-10)
    assert np.allclose(motion.states[-1][0], state, rtol=0, atol=1e-10)
    path = CubicSpline([0, 0.25, 0.5, 0.75, 1.0], PADDLE)
    t = np.linspace(0, 1, 51)
    assert np.allclose(motion.states[:, 1, :2], path(t), rtol=0, atol=1e-13)
    assert np.allclose(motion.states[:, 1, 2:], path(t, 1), rtol=0, atol=1e-12)
    h = 1e-6
    by = np.sum([sign * np.sum((paddle_ball(0.1 + sign * h)[0][:2] - 1) ** 2) for sign in (1, -1)]) / (2 * h)
    assert saltus.loss_and_gradient(paddled()).gradient["velocity"][0][0] == pytest.approx(by, rel=1e-7)


W = np.array([0.7, 1.1])


def dropped(wall, moving, **keys):
    """A ball on a disc or a plane that rests, or both as they are seen from something that moves with the velocity -W."""
    ball = {"name": "ball", "radius": 0.1, "mass": 0.4, "position": [0.05, 1.0], "velocity": [0.4, -2.0] + W * moving}
    scene = {
        "name": "dropped", "duration": 0.6, "steps": 600, "gravity": [0, -2.0], "optimize": "velocity", "bodies": [ball],
        "contact": {"restitution": 0.7}, "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [1, 1]}]}}
    if wall == "disc":
        rests, path = {"fixed": True, "position": [0, 0]}, {"path": {"times": [0, 1], "positions": [[0, 0], W]}}
        scene["bodies"].append({"name": "wall", "radius": 0.3, **(path if moving else rests)})
    else:
        rests, path = {"point": [0, 0.3]}, {"motion": {"times": [0, 1], "positions": [[0, 0.3], [0, 0.3] + W]}}
        scene["planes"] = [{"name": "wall", "normal": [0.1, 1.0], **(path if moving else rests)}]
    return {**scene, **keys}


def galilean_error(contact, wall, **keys):
    rests, moves = (saltus.rollout(dropped(wall, moving, **keys), contact).states[-1][0, :4] for moving in (False, True))
    return np.abs(moves - rests - np.concatenate([0.6 * W, W])).max()


@pytest.mark.parametrize("contact", sorted(saltus.contact_models()))
def test_a_wall_that_moves_uniformly_is_a_wall_at_rest(contact):
    if contact == "ipc_barrier":
        with pytest.raises(ValueError, match="prescribed motions: what moves whatever it meets leaves no gap for a barrier"):
            galilean_error(contact, "disc")
        return
    assert galilean_error(contact, "disc") < 1e-10
    # A disc behind the plane takes its place, whose surface turns within a step.
    if contact == "event":
        assert galilean_error(contact, "plane") < 1e-12
    elif contact != "pbd_brax":  # where the depth of overlaps decides by rounding about the rebound
        assert galilean_error(contact, "plane") < 5e-3
        assert galilean_error(contact, "plane", steps=6000) < 7e-4


CONVERGENT = ["lcp", "lcp_kkt", "convex", "convex_toi", "direct", "direct_toi", "toi_velocity", "ncp_restitution", "qcqp", "xpbd"]


@pytest.mark.parametrize("make", [between_walls, paddled])
def test_models_with_restitution_converge_to_event(make):
    scene = {**make(), "duration": 1.0}
    exact = saltus.rollout(scene)
    assert len(exact.events) >= 1
    for contact in CONVERGENT:
        errors = [np.abs(saltus.rollout({**scene, "steps": steps}, contact).states[-1][0, :4] - exact.states[-1][0]).max()
                  for steps in (500, 8000)]
        assert errors[1] < 6e-3 and errors[1] < 0.35 * errors[0], (contact, errors)


@pytest.mark.parametrize("make", [between_walls, paddled])
@pytest.mark.parametrize("contact", ["direct", "qcqp", "xpbd"])
def test_gradients_of_time_stepping_models_are_those_of_differences(make, contact):
    scene = saltus.Scene({**make(), "steps": 64})
    found = saltus.loss_and_gradient(scene, contact).gradient
    for key in ("position", "velocity"):
        for j in range(2):
            def loss(change, key=key, j=j):
                data = scene.to_dict()
                data["bodies"][0][key][j] += change
                return saltus.loss_and_gradient(data, contact).loss

            assert found[key][0][j] == pytest.approx((loss(1e-6) - loss(-1e-6)) / 2e-6, rel=1e-6, abs=1e-6)


def test_steps_by_themselves_have_no_time():
    simulation = saltus.Simulation(paddled(), "lcp")
    with pytest.raises(ValueError, match="the scene has prescribed motions, and a step by itself has no time: use rollout"):
        simulation.step(simulation.rollout()["states"][0])


def test_scenes_keep_their_paths():
    for scene in (saltus.Scene(between_walls()), saltus.Scene(paddled())):
        assert saltus.Scene(scene.to_dict()) == scene
    data = saltus.Scene(paddled()).to_dict()
    assert data["bodies"][1]["path"]["positions"] == PADDLE.tolist() and "position" not in data["bodies"][1]


def test_a_solver_finds_a_certified_optimum_with_a_paddle():
    scene = paddled(optimize="control", control={"bodies": ["ball"], "initial": [[0.1, 0]]},
                    objective={"terminal": [{"body": "ball", "quantity": "position", "target": [0.4, 0.9]}], "effort": 0.1})
    run = saltus.solve(scene, solver="ceres_phases")
    assert run.termination == "converged" and run.certificate.verdict in ("stationary", "stationary_on_grid")
    assert run.final_loss < 0.5 * run.initial_loss
    assert run.exact_loss == pytest.approx(run.final_loss, rel=1e-9)
    assert len(run.events) >= 1


@pytest.mark.parametrize("path, message", [
    ({"times": [0, 0.5], "positions": [[0, 0], [1, 1]]}, r"path: found times from 0 to 0.5, expected them to cover the motion"),
    ({"times": [0, 1, 1], "positions": [[0, 0]] * 3}, r"path\[2\]: expected times that rise"),
    ({"times": [0, 1], "positions": [[0, 0]]}, r"path: found 2 times and 1 positions"),
])
def test_wrong_paths_are_refused(path, message):
    scene = paddled()
    scene["bodies"][1]["path"] = path
    with pytest.raises(saltus.SceneError, match=message):
        saltus.Scene(scene)
    scene["bodies"][1] = {**paddled()["bodies"][1], "position": [0, 0]}
    with pytest.raises(saltus.SceneError, match=r"bodies\[1\].position: found it beside a path"):
        saltus.Scene(scene)


@pytest.mark.parametrize("moving", ["plane", "body"])
def test_a_filter_of_a_scene_with_a_prescribed_motion_is_refused_and_that_of_its_hybrid_problem_is_right(moving):
    """A prediction in two parts is that in one; the clock of a scene would begin anew."""
    scene = {"name": "moving", "duration": 1.0, "steps": 10, "gravity": [0, 0], "contact": {"restitution": 1, "friction": 0},
             "bodies": [{"name": "ball", "radius": 0.1, "mass": 1, "position": [0, 0.5], "velocity": [0, -1]}],
             "planes": [{"name": "floor", "point": [0, 0], "normal": [0, 1]}],
             "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [0, 1]}]}, "optimize": "velocity"}
    times, places = [0, 0.5, 1], [[0, 0], [0, 0.1], [0, 0.4]]
    if moving == "plane":
        del scene["planes"][0]["point"]
        scene["planes"][0]["motion"] = {"times": times, "positions": places}
    else:
        scene["bodies"].append({"name": "paddle", "radius": 0.1, "path": {"times": times, "positions": [[5, y] for _, y in places]}})
    problem = saltus.hybrid_problem(scene)
    n = len(problem.initial)
    with pytest.raises(ValueError, match=r"prescribed motion.*hybrid_problem\(scene\)\.system"):
        saltus.SaltedKalmanFilter(scene, problem.initial, 1e-6 * np.eye(n))
    given = {"parameters": problem.parameters}
    one, two = (saltus.SaltedKalmanFilter(problem.system, problem.initial, 1e-6 * np.eye(n), **given) for _ in range(2))
    one.predict(1.0)
    two.predict(0.2)
    two.predict(1.0)
    assert np.allclose(one.mean, saltus.rollout(problem).final, rtol=0, atol=1e-9)
    assert np.allclose(one.mean, two.mean, rtol=0, atol=1e-9)


def test_the_start_of_a_body_with_a_path_is_that_of_the_path():
    """The velocity of a run, as README gives it to rollout, has that of the path; another start is refused."""
    scene = {"name": "paddle", "duration": 1.0, "steps": 10, "gravity": [0, 0], "contact": {"restitution": 1, "friction": 0},
             "bodies": [{"name": "ball", "radius": 0.1, "mass": 1, "position": [0, 0.5], "velocity": [0, -1]},
                        {"name": "paddle", "radius": 0.1, "path": {"times": [0, 1], "positions": [[0, -0.5], [0, 0.5]]}}],
             "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [0, 1]}]}, "optimize": "velocity"}
    expected = saltus.rollout(scene).states
    for velocity in ([[0, -1], [0, 1]], [[0, -1], [0, 0]]):
        assert np.array_equal(saltus.rollout(scene, velocity=velocity).states, expected)
    assert np.array_equal(saltus.rollout(scene, position=[[0, 0.5], [0, -0.5]]).states, expected)
    with pytest.raises(ValueError, match=r"position\[1\]: found \[5, 5\], expected \[0, -0.5\], with which the path of 'paddle' begins"):
        saltus.rollout(scene, position=[[0, 0.5], [5, 5]])
    with pytest.raises(ValueError, match=r"velocity\[1\]: found \[0, 2\], expected \[0, 1\]"):
        saltus.rollout(scene, velocity=[[0, -1], [0, 2]])


def test_a_plane_that_moves_is_drawn_where_it_begins():
    plot = pytest.importorskip("saltus.plot")
    pytest.importorskip("matplotlib").use("Agg")
    axes = plot.trajectory(between_walls(), saltus.rollout(between_walls()))
    assert len(axes.lines) >= 3


def test_a_hybrid_problem_does_not_go_on_beyond_the_paths_of_its_scene():
    problem = saltus.hybrid_problem(between_walls())
    problem.duration = 2.0
    saltus.rollout(pickle.loads(pickle.dumps(problem)))
    problem.duration = 2.1
    with pytest.raises(ValueError, match="duration: found 2.1, expected at most 2, at which a prescribed motion of the scene ends"):
        saltus.rollout(problem)


@pytest.mark.parametrize("times", [[0, 0.25, 0.5, 0.75, 1], [0, 0.33, 0.71, 0.9, 1]])
def test_where_the_path_of_a_disc_far_away_turns_is_no_kink_of_a_running_cost(times):
    scene = {"name": "far", "duration": 1.0, "steps": 50, "control": {"bodies": ["ball"], "initial": [[0.1, 0]]}, "optimize": "control",
             "bodies": [{"name": "ball", "radius": 0.1, "mass": 1, "position": [0, 0]}],
             "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [1, 0]}], "effort": 0.1,
                           "running": [{"body": "ball", "quantity": "position", "target": [[0, 0.4, 0.9]], "weight": 0.3}]}}
    alone = saltus.solve(scene, "event", "ceres_phases")
    path = {"times": times, "positions": [[5 + 0.1 * (k % 2), 0] for k in range(len(times))]}
    scene["bodies"].append({"name": "paddle", "radius": 0.1, "path": path})
    beside = saltus.solve(scene, "event", "ceres_phases")
    assert alone.termination == beside.termination == "converged"
    assert beside.certificate.verdict == alone.certificate.verdict
    assert beside.durations.min() > 1e-3  # no interval is spent on the turn at the final time
    assert beside.final_loss == pytest.approx(alone.final_loss, rel=2e-6)  # intervals end where the path turns
