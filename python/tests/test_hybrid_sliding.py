"""Motions along a jump of the flow, by Filippov's convention (sliding="filippov"), against closed forms and another method."""

import copy
import itertools
import math
import pickle

import numpy as np
import pytest
from conftest import load_campaign
from numpy.testing import assert_allclose

import saltus


def one_mode(flow, states=("x",), parameters=(), **rest):
    return saltus.HybridSystem(states={"m": list(states)}, parameters=list(parameters), flow={"m": flow}, sliding="filippov", **rest)


def motion_of(system, initial, parameters, duration, **options):
    problem = saltus.HybridProblem(system, mode="m", initial=initial, parameters=parameters, duration=duration, **options)
    motion, d = saltus.rollout(problem), saltus.final_derivatives(problem)
    assert motion.remark == d.remark == ""
    assert motion.integration_error <= 1e-12
    return motion, d


def differences(final, inputs):
    """Central differences of a closed form by its inputs, with an error of the fourth order."""
    columns = []
    for i in range(len(inputs)):
        def at(step):
            moved = list(inputs)
            moved[i] += step
            return np.array(final(*moved))
        h = 1e-3
        columns.append((8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h))
    return np.transpose(columns)


def belt(duration):
    """The closed form of a block on a spring and a belt: it slips, sticks, and slips again; by x, v, k, F, belt speed."""
    def final(x, v, k, friction, speed):
        w, middle = math.sqrt(k), friction / k
        size, phase = math.hypot(v, w * (x - middle)), math.atan2(w * (x - middle), v)
        sticks = (-math.acos(speed / size) - phase) / w
        at = middle + size / w * math.sin(w * sticks + phase)
        slips = sticks + (middle - at) / speed
        assert 0 < sticks < slips
        if duration < slips:
            return [at + speed * (duration - sticks), speed]
        after = w * (duration - slips)
        return [middle + speed / w * math.sin(after), speed * math.cos(after)]
    return final


@pytest.mark.parametrize("duration, events", [(1.5, 1), (4.0, 2)])
def test_a_block_on_a_belt_sticks_and_slips(duration, events):
    system = one_mode(lambda t, x, u, p: [x[1], -p[0] * x[0] - p[1] * np.sign(x[1] - p[2])], ["x", "v"], ["k", "F", "w"])
    inputs = [-0.3, 0.1, 2.0, 1.5, 0.5]
    motion, d = motion_of(system, inputs[:2], inputs[2:], duration)
    assert len(motion.switches) == events and motion.events == []
    assert_allclose(motion.final, belt(duration)(*inputs), rtol=1e-11, atol=1e-12)
    by = differences(belt(duration), inputs)
    assert_allclose(np.hstack([d.by_initial, d.by_parameters]), by, atol=1e-8)
    final = [motion.final[1], (1.5 - 2 * motion.final[0] if events == 2 else 0)]
    assert_allclose(d.by_duration, final, atol=1e-10)


def test_a_relay_holds_its_state():
    system = one_mode(lambda t, x, u, p: [p[0] * x[0] + 0.3 - saltus.where(x[0] > p[1], 1.0, -1.0)], parameters=["a", "set"])
    motion, d = motion_of(system, [1.0], [0.2, 0.5], 4.0)
    assert_allclose(motion.final, [0.5], rtol=1e-12)
    assert_allclose([d.by_initial[0, 0], *d.by_parameters[0], d.by_duration[0]], [0, 0, 1, 0], atol=1e-12)


def test_a_motion_along_a_moving_curve():
    """x0 is driven towards sin t; x1' = x0 + 0.4 on one side and -1 on the other. Along it x1' follows from the weights."""
    def flow(t, x, u, p):
        above = x[0] > np.sin(p[0] * t)
        return [saltus.where(above, -2.0 + 0.1 * x[1], 1.5), saltus.where(above, x[0] + 0.4, -1.0)]

    system = one_mode(flow, ["a", "b"], ["w"])
    motion, d = motion_of(system, [0.6, 0.2], [1.3], 1.1)

    def exact(a, b, w):
        steps = 4000  # of the Runge-Kutta method of order 4
        def rk4(f, t, y, h):
            k1 = f(t, y); k2 = f(t + h / 2, y + h / 2 * k1); k3 = f(t + h / 2, y + h / 2 * k2); k4 = f(t + h, y + h * k3)
            return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        above = lambda t, y: np.array([-2 + 0.1 * y[1], y[0] + 0.4])
        start = np.array([a, b])
        to = lambda end: (lambda y: y)(_run(rk4, above, start, end, 200))
        low, high = 0.0, 0.5
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if to(middle)[0] > math.sin(w * middle) else (low, middle)
        def along(t, y):
            x = math.sin(w * t)
            rate = w * math.cos(w * t)
            weight = (rate - 1.5) / (-2 + 0.1 * y[0] - 1.5)
            return np.array([weight * (x + 0.4) - (1 - weight)])
        y, h = to(low)[1:], (1.1 - low) / steps
        for i in range(steps):
            y = rk4(along, low + i * h, y, h)
        return [math.sin(w * 1.1), y[0]]

    assert_allclose(motion.final, exact(0.6, 0.2, 1.3), rtol=1e-9)
    assert_allclose(np.hstack([d.by_initial, d.by_parameters]), differences(exact, [0.6, 0.2, 1.3]), atol=1e-7)


def _run(step, f, y, end, steps):
    for i in range(steps):
        y = step(f, i * end / steps, y, end / steps)
    return y


def test_two_blocks_stick_at_the_same_time():
    """Each one comes to rest by its own friction while a spring between them holds less; the closed form of two stops."""
    def flow(t, x, u, p):
        spring = p[0] * (x[1] - x[0] - 1)
        return [x[2], x[3], spring - p[1] * np.sign(x[2]), (-spring - p[2] * np.sign(x[3])) / 2]

    system = one_mode(flow, ["x", "y", "v", "w"], ["k", "f", "g"])
    motion, d = motion_of(system, [0, 1, 0.2, -0.3], [0.4, 2.0, 3.0], 2.0)
    assert_allclose(motion.final[2:], [0, 0], atol=1e-12)
    assert len(motion.switches) == 2
    assert_allclose(d.by_duration, np.zeros(4), atol=1e-12)
    # At rest from then on: the end is that of a motion until both rest, whatever the duration.
    h, base = 1e-5, [0, 1, 0.2, -0.3, 0.4, 2.0, 3.0]
    by = []
    for i in range(7):
        ends = []
        for step in (h, -h):
            moved = list(base)
            moved[i] += step
            ends.append(saltus.rollout(saltus.HybridProblem(system, mode="m", initial=moved[:4], parameters=moved[4:], duration=1.0)).final)
        by.append((ends[0] - ends[1]) / (2 * h))
    assert_allclose(np.hstack([d.by_initial, d.by_parameters]), np.transpose(by), atol=1e-8)


def test_a_block_that_begins_at_rest_is_pushed():
    """At rest until the second interval, under less than the friction; there it moves. Nothing that begins off the surface
    at rest stays off it: the derivative by the initial speed is that of both sides, zero."""
    system = one_mode(lambda t, x, u, p: [x[1], u[0] - p[0] * np.sign(x[1])], ["x", "v"], ["f"], controls=["u"])
    motion, d = motion_of(system, [0.3, 0.0], [1.0], 2.0, control=[[0.6], [1.5]])
    assert_allclose(motion.final, [0.3 + 0.25, 0.5], rtol=1e-12)
    assert_allclose(d.by_initial, [[1, 0], [0, 0]], atol=1e-12)
    assert_allclose(d.by_parameters, [[-0.5], [-1]], atol=1e-12)
    assert_allclose(d.by_control.reshape(2, -1), [[0, 0.5], [0, 1]], atol=1e-12)
    # x = 0.3 + (u - f) (T / 2)^2 / 2
    assert_allclose(d.by_duration, [0.5 * 0.5 * 2 / 2, 0.25], atol=1e-12)


def test_a_reset_onto_the_surface():
    """A carriage is caught: its speed is set to zero, where friction holds it; the time of the catch is that of a guard."""
    system = one_mode(
        lambda t, x, u, p: [x[1], 0.5 - p[0] * np.sign(x[1])], ["x", "v"], ["f"],
        guards={"m": {"catch": lambda t, x, p: 1 - x[0]}}, resets={"m": {"catch": lambda t, x, p: ("m", [0.0, 0.0])}})
    motion, d = motion_of(system, [0.0, 2.0], [1.0], 3.0)
    assert len(motion.events) == 1
    assert_allclose(motion.final, [0, 0], atol=1e-13)
    assert_allclose(np.hstack([d.by_initial, d.by_parameters, d.by_duration[:, None]]), np.zeros((2, 4)), atol=1e-12)


def test_a_guard_ends_the_sliding():
    """A block carried by a belt falls off its end, at x = 1, into another mode."""
    system = saltus.HybridSystem(
        states={"m": ["x", "v"], "air": ["x", "v", "y"]}, parameters=["f", "w"], sliding="filippov",
        flow={"m": lambda t, x, u, p: [x[1], -p[0] * np.sign(x[1] - p[1])], "air": lambda t, x, u, p: [x[1], 0, -t]},
        guards={"m": {"end": lambda t, x, p: 1 - x[0]}}, resets={"m": {"end": lambda t, x, p: ("air", [x[0], x[1], 0])}})
    motion, d = motion_of(system, [0.0, 0.0], [2.0, 0.8], 2.0)
    # v = f t until w / f = 0.4, where x = w^2 / (2 f) = 0.16; off at te = 0.4 + 0.84 / 0.8
    def final(x, v, f, w):
        stick = (w - v) / f
        off = stick + (1 - x - (w * w - v * v) / (2 * f)) / w
        return [1 + w * (2 - off), w, -(4 - off**2) / 2]
    assert_allclose(motion.final, final(0, 0, 2, 0.8), rtol=1e-12)
    assert_allclose(np.hstack([d.by_initial, d.by_parameters]), differences(final, [0, 0, 2, 0.8]), atol=1e-8)


def test_the_gradient_of_a_loss_and_a_solver():
    system = one_mode(lambda t, x, u, p: [x[1], u[0] - p[0] * np.sign(x[1])], ["x", "v"], ["f"], controls=["u"])
    problem = saltus.HybridProblem(system, mode="m", initial=[0.0, 0.4], parameters=[1.0], duration=2.0, control=[[0.0], [1.4]],
                                   costs=[saltus.terminal([0.5, 0.3]), saltus.effort(0.01)])
    # At rest at t = 0.4, x = 0.08; from t = 1 on x'' = u - 1.
    g = saltus.loss_and_gradient(problem)
    x, v = 0.08 + 0.2, 0.4
    assert_allclose(g.loss, (x - 0.5) ** 2 + (v - 0.3) ** 2 + 0.01 * 1.4**2, rtol=1e-11)
    assert_allclose(g.gradient.control.ravel(), [2 * (x - 0.5) * 0.4 * 0.2, 2 * (x - 0.5) * 0.5 + 2 * (v - 0.3) + 0.02 * 1.4], atol=1e-11)
    run = saltus.solve(problem, solver="ceres_lm")
    assert run.loss < g.loss and run.termination == "converged"


def test_functions_that_filippov_does_not_determine_are_refused():
    def flow(t, x, u, p):  # the change at one condition depends on the other one
        a, b = saltus.where(x[0] > 0, 1.0, -1.0), saltus.where(x[1] > 0, 1.0, -1.0)
        return [-a + 0.3 * b, -b - 0.4 * a * b]

    both = saltus.HybridProblem(one_mode(flow, ["a", "b"]), mode="m", initial=[0.5, 0.9], duration=3.0)
    with pytest.raises(RuntimeError, match="points at it .* would slide along"):
        saltus.rollout(both)
    guard = one_mode(lambda t, x, u, p: [saltus.where(x[0] > 0, -1.0, 1.0)], guards={"m": {"g": lambda t, x, p: saltus.where(x[0] > 0, 3.0, 2.0) - t}},
                     resets={"m": {"g": lambda t, x, p: ("m", x)}})
    with pytest.raises(RuntimeError, match="would slide along"):
        saltus.rollout(saltus.HybridProblem(guard, mode="m", initial=[0.5], duration=3.0))


def test_the_option():
    flow = {"m": lambda t, x, u, p: [0.5 - np.sign(x[0])]}
    with pytest.raises(ValueError, match="sliding: found 'yes', expected 'filippov' or None"):
        saltus.HybridSystem(states={"m": ["x"]}, flow=flow, sliding="yes")
    problem = saltus.HybridProblem(saltus.HybridSystem(states={"m": ["x"]}, flow=flow, sliding="filippov"), mode="m", initial=[1.0],
                                   duration=3.0)
    for same in (problem, copy.deepcopy(problem), pickle.loads(pickle.dumps(problem))):
        assert_allclose(saltus.rollout(same).final, [0], atol=1e-13)


def test_random_systems_that_slide_agree_with_another_method():
    campaign = load_campaign("random_sliding_systems")
    kinds = [campaign.compare(seed)[0] for seed in (0, 2, 3, 5, 46)]
    assert kinds == ["agrees"] * 5


@pytest.mark.parametrize("frictions", [(0.5,), (0.5, 0.5), (0.3, 0.6), (0.4, 0.9)])
def test_blocks_that_stop_at_a_jump_of_the_control_start_again_at_the_next(frictions):
    """Rounding decides whether each stops before the control jumps or behind: the motion is the same to rounding."""
    n = len(frictions)
    flow = lambda x, u, p: [*x[n:], *[u[0] - p[i] * np.sign(x[n + i]) for i in range(n)]]
    system = one_mode(flow, [*[f"x{i}" for i in range(n)], *[f"v{i}" for i in range(n)]], [f"f{i}" for i in range(n)], controls=["u"])
    f = np.array(frictions)
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[*[0] * n, *(1 + f)], parameters=frictions, duration=3.0,
                                                 control=[[-1], [0], [1]]))
    assert_allclose(motion.final[:n], (1 + f) / 2 + (1 - f) / 2, rtol=1e-12)
    assert_allclose(motion.final[n:], 1 - f, rtol=1e-12)


def block_alone(v, controls, friction, length):
    """The final position and velocity of a block that starts at 0, pushed by the controls, each over a time of `length`."""
    x = 0.0
    for u in controls:
        left = length
        while left > 1e-13:
            direction = np.sign(v) if abs(v) > 1e-13 else np.sign(u) if abs(u) > friction else 0
            acceleration = u - friction * direction if direction else 0.0
            step = min(left, -v / acceleration) if acceleration * v < 0 and abs(v) > 1e-13 else left
            x, v, left = x + v * step + acceleration * step * step / 2, v + acceleration * step, left - step
            v = 0.0 if step < left or abs(v) < 1e-13 else v
    return np.array([x, v])


AFTER = {"stays": 0.4, "goes on": 2.1, "goes back": -2.3, "as before": None, "had stopped and starts": -1.7}


@pytest.mark.parametrize("after", itertools.product(AFTER, repeat=2))
def test_blocks_that_stop_where_the_control_jumps(after):
    # Both stop at the jump, but one that had stopped before. What the one does changes nothing for the other.
    length, friction, first = 0.7071, [1.1, 0.7], [-0.3, 0.41]
    control = np.array([first, [AFTER[a] * mu if AFTER[a] else u for a, mu, u in zip(after, friction, first)]])
    v = [(mu - u) * length * (0.6 if a.startswith("had") else 1) for a, mu, u in zip(after, friction, first)]
    system = saltus.HybridSystem(states={"m": ["x", "y", "v", "w"]}, controls=["u", "r"], sliding="filippov",
                                 flow={"m": lambda x, u: [x[2], x[3], *(u[i] - friction[i] * np.sign(x[2 + i]) for i in (0, 1))]})
    found = saltus.final_derivatives(saltus.HybridProblem(system, mode="m", initial=[0, 0, *v], control=control, duration=2 * length))
    for i, name in enumerate("vw"):
        alone = lambda change: block_alone(v[i] + change, control[:, i], friction[i], length)
        sides = [(alone(side) - alone(0)) / side for side in (-1e-7, 1e-7)]
        derivative = found.by_initial[i::2, 2 + i]
        assert min(np.abs(derivative - side).max() for side in sides) < 1e-5
        assert_allclose(found.by_initial[i::2, 3 - i], 0, atol=1e-12)
        differ = np.abs(sides[0] - sides[1]).max() > 1e-5
        assert differ == (after[i] in ("goes on", "goes back"))
        assert not differ or name in found.remark
    if not any(a in ("goes on", "goes back", "had stopped and starts") for a in after):
        assert found.remark == ""


def test_blocks_that_stop_at_the_final_time():
    system = saltus.HybridSystem(states={"m": ["v", "w"]}, flow={"m": lambda x: [-1.1 * np.sign(x[0]), -0.7 * np.sign(x[1])]})
    problem = saltus.HybridProblem(system, mode="m", initial=[1.1 * 0.3, -0.7 * 0.3], duration=0.3)
    assert saltus.final_derivatives(problem).remark == "; ".join(
        f"switch '{name}', at which the flow jumps, is zero at the final time" for name in "vw")
