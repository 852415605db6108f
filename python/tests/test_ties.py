"""Events of hybrid systems at one time: their order, one-sided derivatives, and events that accumulate."""

import math
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

import saltus


def dosing(order):
    guard = {"dose": lambda t, x, p: 1 + p[0] - t, "change": lambda t, x, p: 1.5 - t}
    resets = {"dose": lambda t, x, p: ("dosed", [x[0] + 2]), "change": lambda t, x, p: ("changed", x)}
    return saltus.HybridSystem(
        states={k: ["A"] for k in ("both", "dosed", "changed", "end")}, parameters=["lag"],
        flow={k: (lambda t, x, u, p, k=k: [-(0.5 if k in ("both", "dosed") else 0.8) * x[0]])
              for k in ("both", "dosed", "changed", "end")},
        guards={"both": {k: guard[k] for k in order}, "dosed": {"change": guard["change"]},
                "changed": {"dose": guard["dose"]}},
        resets={"both": {k: resets[k] for k in order}, "dosed": {"change": lambda t, x, p: ("end", x)},
                "changed": {"dose": lambda t, x, p: ("end", [x[0] + 2])}})


@pytest.mark.parametrize("order", [["dose", "change"], ["change", "dose"]])
def test_orders_that_lead_to_one_state_and_two_derivatives(order):
    problem = saltus.HybridProblem(dosing(order), mode="both", initial=[3], parameters=[0.5], duration=2.5)
    found = saltus.final_derivatives(problem)
    assert "the derivatives depend on the order of their events" in found.remark
    assert "'dose'" in found.remark and "'change'" in found.remark
    sides = 0.449328964117222, 0.718926342587554  # the dose before the change, and after it
    assert min(abs(found.by_parameters[0, 0] - side) for side in sides) < 1e-12
    for lag, side in ((0.4999, sides[0]), (0.5001, sides[1])):
        problem.parameters = [lag]
        found = saltus.final_derivatives(problem)
        assert found.remark == ""
        assert_allclose(found.by_parameters[0, 0], side, rtol=2e-4)


def test_tied_events_with_times_that_nothing_changes_have_a_derivative():
    # The lag is a constant: no change of the state moves one event past the other.
    system = saltus.HybridSystem(
        states={k: ["A"] for k in ("a", "b", "c", "d")},
        flow={k: (lambda t, x, u, p, k=k: [-(0.5 if k in "ab" else 0.8) * x[0]]) for k in "abcd"},
        guards={"a": {"dose": lambda t, x, p: 1.5 - t, "change": lambda t, x, p: 1.5 - t},
                "b": {"change": lambda t, x, p: 1.5 - t}, "c": {"dose": lambda t, x, p: 1.5 - t}},
        resets={"a": {"dose": lambda t, x, p: ("b", [x[0] + 2]), "change": lambda t, x, p: ("c", x)},
                "b": {"change": lambda t, x, p: ("d", x)}, "c": {"dose": lambda t, x, p: ("d", [x[0] + 2])}})
    found = saltus.final_derivatives(saltus.HybridProblem(system, mode="a", initial=[3], duration=2.5))
    assert found.remark == ""
    assert_allclose(found.by_initial, [[math.exp(-0.75 - 0.8)]], rtol=1e-11)


def clocks_with_flags(order):
    guards = {"ring a": lambda t, x, p: x[0], "ring b": lambda t, x, p: x[1],
              "act a": lambda t, x, p: saltus.where(x[2] > 0.5, -1, 1),
              "act b": lambda t, x, p: saltus.where(x[3] > 0.5, -1, 1)}
    resets = {"ring a": lambda t, x, p: ("run", [9, x[1], 1, *x[3:]]),
              "ring b": lambda t, x, p: ("run", [x[0], 9, x[2], 1, *x[4:]]),
              "act a": lambda t, x, p: ("run", [x[0], x[1], 0, x[3], 0, x[5]]),
              "act b": lambda t, x, p: ("run", [x[0], x[1], x[2], 0, x[4], 0])}
    return saltus.HybridSystem(
        states={"run": ["a", "b", "flag a", "flag b", "ya", "yb"]}, flow={"run": lambda t, x, u, p: [-1, -1, 0, 0, 1, 1]},
        guards={"run": {name: guards[name] for name in order}}, resets={"run": {name: resets[name] for name in order}})


@pytest.mark.parametrize("order", [["ring a", "ring b", "act a", "act b"], ["ring a", "act a", "ring b", "act b"],
                                   ["act a", "act b", "ring a", "ring b"], ["act b", "ring b", "act a", "ring a"]])
def test_transitions_that_an_event_enables_belong_to_it(order):
    system = clocks_with_flags(order)
    for b in (0.7, 0.8):
        found = saltus.final_derivatives(
            saltus.HybridProblem(system, mode="run", initial=[0.7, b, 0, 0, 0, 0], duration=2))
        assert found.remark == ""
        assert_allclose(found.by_initial[4:, :2], [[-1, 0], [0, -1]], atol=1e-12)


def test_a_flow_between_tied_events_is_a_kink():
    # x' = 1 while one of two clocks has rung: x = |a - b|.
    system = saltus.HybridSystem(
        states={"run": ["a", "b", "flag a", "flag b", "x"]},
        flow={"run": lambda t, x, u, p: [-1, -1, 0, 0, x[2] + x[3] - 2 * x[2] * x[3]]},
        guards={"run": {"ring a": lambda t, x, p: x[0], "ring b": lambda t, x, p: x[1]}},
        resets={"run": {"ring a": lambda t, x, p: ("run", [9, x[1], 1, *x[3:]]),
                        "ring b": lambda t, x, p: ("run", [x[0], 9, x[2], 1, x[4]])}})
    for b, slopes in ((0.6999, [1, -1]), (0.7, None), (0.7001, [-1, 1])):
        found = saltus.final_derivatives(saltus.HybridProblem(system, mode="run", initial=[0.7, b, 0, 0, 0], duration=2))
        if slopes is None:
            assert "'ring a', 'ring b'" in found.remark
        else:
            assert found.remark == ""
            assert_allclose(found.by_initial[4, :2], slopes, atol=1e-12)


@pytest.mark.parametrize("duration, time, gap", [(2, 1, 1e-9), (1e4, 1, 1e-9), (1e4, 9e3, 1e-9), (3.15e7, 1, 1e-5),
                                                 (3.15e7, 3e7, 1e-5), (3.15e7, 3e7, 1e-6)])
@pytest.mark.parametrize("order", [["add", "double"], ["double", "add"]])
def test_events_are_taken_in_the_order_of_time(duration, time, gap, order):
    guard = {"double": lambda t, x, p: time - t, "add": lambda t, x, p: time + p[0] - t}
    resets = {"add": lambda t, x, p: ("added", [x[0] + 1]), "double": lambda t, x, p: ("doubled", [2 * x[0]])}
    system = saltus.HybridSystem(
        states={k: ["x"] for k in ("both", "doubled", "added", "end")}, parameters=["gap"],
        flow={k: (lambda t, x, u, p: [0.0]) for k in ("both", "doubled", "added", "end")},
        guards={"both": {k: guard[k] for k in order}, "doubled": {"add": guard["add"]},
                "added": {"double": guard["double"]}},
        resets={"both": {k: resets[k] for k in order}, "doubled": {"add": lambda t, x, p: ("end", [x[0] + 1])},
                "added": {"double": lambda t, x, p: ("end", [2 * x[0]])}})
    for sign, expected in ((1, 3), (-1, 4)):
        motion = saltus.rollout(saltus.HybridProblem(system, mode="both", initial=[1], parameters=[sign * gap],
                                                     duration=duration))
        assert motion.final[0] == expected
        assert motion.remark == ""


def test_cells_that_synchronize_are_not_ambiguous():
    def flow(t, x, u, p):
        return [1.3 - x[0] + x[2], 1.3 - x[1] + x[4], x[3] - x[2], -x[3], x[5] - x[4], -x[5]]

    cells = saltus.HybridSystem(
        states={"m": ["x1", "x2", "s1", "r1", "s2", "r2"]}, flow={"m": flow},
        guards={"m": {"1": lambda t, x, p: 1 - x[0], "2": lambda t, x, p: 1 - x[1]}},
        resets={"m": {"1": lambda t, x, p: ("m", [0, x[1], x[2], x[3], x[4], x[5] - 0.4]),
                      "2": lambda t, x, p: ("m", [x[0], 0, x[2], x[3] - 0.4, x[4], x[5]])}})
    motion = saltus.rollout(saltus.HybridProblem(cells, mode="m", initial=[0, 0.3, 0, 0, 0, 0], duration=200))
    assert motion.remark == ""
    assert len(motion.events) == 184
    assert_allclose(motion.final[:2], 0.640949270801252643, atol=1e-9)


def test_a_control_that_jumps_at_an_event_that_does_not_depend_on_it():
    # A ball, and a cart that the control pushes: the impact is where the control jumps.
    system = saltus.HybridSystem(
        states={"air": ["y", "v", "x", "w"]}, controls=["f"],
        flow={"air": lambda t, x, u, p: [x[1], -8, x[3], u[0]]}, guards={"air": {"ground": lambda t, x, p: x[0]}},
        resets={"air": {"ground": lambda t, x, p: ("air", [x[0], -0.6 * x[1], x[2], x[3]])}})
    problem = saltus.HybridProblem(system, mode="air", initial=[1, 0, 0, 0], duration=1, control=[[0], [1]])
    found = saltus.final_derivatives(problem)
    assert found.remark == ""
    assert_allclose(found.by_initial[0, 0], -0.6 + (1 + 0.6) * 8 / 4 * 0.5, rtol=1e-12)
    coupled = saltus.HybridSystem(
        states={"air": ["y", "v"]}, controls=["f"], flow={"air": lambda t, x, u, p: [x[1], u[0] - 8]},
        guards={"air": {"ground": lambda t, x, p: x[0]}},
        resets={"air": {"ground": lambda t, x, p: ("air", [x[0], -0.6 * x[1]])}})
    problem = saltus.HybridProblem(coupled, mode="air", initial=[1, 0], duration=1, control=[[0], [1]])
    assert "where the control jumps" in saltus.rollout(problem).remark


def bouncing(e, **options):
    ball = saltus.HybridSystem(
        states={"air": ["y", "v"], "rest": ["y", "v"]}, parameters=["e"],
        flow={"air": lambda t, x, u, p: [x[1], -9.81], "rest": lambda t, x, u, p: [0, 0]},
        guards={"air": {"ground": lambda t, x, p: x[0]}},
        resets={"air": {"ground": lambda t, x, p: ("air", [0, -p[0] * x[1]])}}, **options)
    return saltus.HybridProblem(ball, mode="air", initial=[1, 0], parameters=[e], duration=12)


@pytest.mark.parametrize("e", [0.9, 0.7, 0.5, 0.3, 0.1, 0.08, 0.05, 0.0])
def test_bounces_that_accumulate_go_on_in_the_mode_that_is_named(e):
    motion = saltus.rollout(bouncing(e, on_accumulation={"air": {"ground": "rest"}}))
    assert motion.mode == "rest"
    assert_allclose(motion.final, 0, atol=1e-6)
    with pytest.raises(RuntimeError, match=r"Zeno behaviour.*guard 'ground'.*on_accumulation") as error:
        saltus.rollout(bouncing(e))
    assert_allclose(error.value.accumulation, math.sqrt(2 / 9.81) * (1 + e) / (1 - e), rtol=1e-9)


def test_bounces_of_a_mechanical_system_that_accumulate_name_its_rest_speed():
    ball = saltus.MechanicalSystem(coordinates=["y"], mass=lambda: [[1]], force=lambda: [-9.81], rest_speed=0,
                                   contacts={"floor": saltus.Contact(gap=lambda q: q[0], restitution=0.5)})
    with pytest.raises(RuntimeError, match="Zeno behaviour.*'hit floor'.* raise rest_speed") as error:
        saltus.rollout(saltus.HybridProblem(ball, initial=[1, 0], duration=3.0))
    assert "on_accumulation" not in str(error.value)


@pytest.mark.parametrize("reads", [True, False])
@pytest.mark.parametrize("second", [0.2, 0.5])
def test_a_guard_that_reads_the_control_at_the_end_of_an_interval(reads, second):
    """x = u t reaches 1 - u as the interval ends. A little later it does in the next one, whose control the guard reads then."""
    lift = saltus.HybridSystem(
        states={"m": ["x"], "n": ["x"]}, controls=["u"], flow={"m": lambda u: [u[0]], "n": lambda x: [0 * x[0]]},
        guards={"m": {"lift": (lambda x, u: 1 - u[0] - x[0]) if reads else (lambda x: 0.5 - x[0])}},
        resets={"m": {"lift": lambda x: ("n", x)}})

    def final(first, then):
        problem = saltus.HybridProblem(lift, mode="m", initial=[0], duration=2.0, control=[[first], [then]])
        return saltus.rollout(problem)

    motion = final(0.5, second)
    assert [event[0] for event in motion.events] == [1.0]
    step = 1e-6
    sides = [(final(0.5 + side, second).final[0] - motion.final[0]) / side for side in (-step, step)]
    assert (abs(sides[0] - sides[1]) > 0.5) == reads
    where = "where the control jumps" if second != 0.5 else "where the next interval of the control begins, which it reads"
    assert motion.remark == (f"guard 'lift' has an event at t = 1, {where}" if reads else "")


def test_a_flow_that_points_at_its_switch_goes_on_in_the_mode_that_is_named():
    box = saltus.HybridSystem(
        states={k: ["x", "v"] for k in ("right", "left", "stick")},
        flow={"right": lambda t, x, u, p: [x[1], -2.94], "left": lambda t, x, u, p: [x[1], 2.94],
              "stick": lambda t, x, u, p: [0, 0]},
        guards={"right": {"stop": lambda t, x, p: x[1]}, "left": {"stop": lambda t, x, p: -x[1]}},
        resets={"right": {"stop": lambda t, x, p: ("left", x)}, "left": {"stop": lambda t, x, p: ("right", x)}},
        on_accumulation={"right": {"stop": "stick"}, "left": {"stop": "stick"}})
    problem = saltus.HybridProblem(box, mode="right", initial=[0, 1], duration=3)
    motion = saltus.rollout(problem)
    assert motion.mode == "stick"
    assert_allclose(motion.final, [1 / (2 * 2.94), 0], atol=1e-14)
    found = saltus.final_derivatives(problem)
    assert found.remark == ""
    assert_allclose(found.by_initial, [[1, 1 / 2.94], [0, 0]], atol=1e-12)


@pytest.mark.parametrize("c", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("level", [0.3, 0.325])
def test_a_reset_to_rest_on_its_own_guard(c, level):
    # x' = v - w, whose difference the event leaves at one unit of rounding, and then v' = -c.
    system = saltus.HybridSystem(
        states={"run": ["x", "v", "w", "b"]}, parameters=["level", "c"],
        flow={"run": lambda t, x, u, p: [x[1] - x[2], -p[1], 0, 0]},
        guards={"run": {"below": lambda t, x, p: saltus.where(x[3] > 0.5, p[0] - x[0], x[0] - p[0])}},
        resets={"run": {"below": lambda t, x, p: ("run", [
            x[0], *saltus.where(x[3] > 0.5, x[1:3], [p[0] - p[0] + 0.1 + 0.2, 0.3]), 1 - x[3]])}})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="run", initial=[1, -1, 0, 0], parameters=[level, c],
                                                 duration=1.5, steps_per_interval=100))
    assert len(motion.events) == 1 and motion.final[3] == 1
    time = motion.events[0][0]
    assert_allclose(motion.final[0] - level, -c * (1.5 - time) ** 2 / 2, rtol=1e-6, atol=1e-14)


def test_a_guard_that_rests_at_zero_has_its_event_when_it_falls():
    # A cart is stopped at 0 and pulled on later: by the control that jumps, or by a force that sets in.
    def cart(force):
        return saltus.HybridSystem(
            states={"run": ["x", "v"], "off": ["x", "v"]}, controls=["f"],
            flow={"run": force, "off": lambda t, x, u, p: [0, 0]},
            guards={"run": {"edge": lambda t, x, p: x[0]}},
            resets={"run": {"edge": lambda t, x, p: ("off", x)}})

    jumps = cart(lambda t, x, u, p: [x[1], u[0]])
    motion = saltus.rollout(saltus.HybridProblem(jumps, mode="run", initial=[0, 0], duration=3, control=[[0], [0], [-1]]))
    assert motion.mode == "off" and "edge" in motion.remark
    assert_allclose(motion.events[0][0], 2, atol=1e-9)
    sets_in = cart(lambda t, x, u, p: [x[1], saltus.where(t > 1.23, -(t - 1.23), 0)])
    motion = saltus.rollout(saltus.HybridProblem(sets_in, mode="run", initial=[0, 0], duration=3))
    assert motion.mode == "off" and "rate of zero" in motion.remark
    assert_allclose(motion.events[0][0], 1.23, atol=5e-3)


@pytest.mark.parametrize("n", [2, 50, 51, 80])
def test_independent_events_at_one_time(n):
    names = [f"x{i}" for i in range(n)] + [f"flag{i}" for i in range(n)]

    def turned(x, i, value, flag):
        after = list(x)
        after[i], after[n + i] = value, flag
        return "run", after

    guards, resets = {}, {}
    for i in range(n):
        guards[f"time{i}"] = lambda t, x, p, i=i: saltus.where(x[i] > 0.5, 1, 1.5 - t)
        resets[f"time{i}"] = lambda t, x, p, i=i: turned(x, i, 1, 1)
    for i in range(n):
        guards[f"act{i}"] = lambda t, x, p, i=i: saltus.where(x[n + i] > 0.5, -1, 1)
        resets[f"act{i}"] = lambda t, x, p, i=i: turned(x, i, x[i], 0)
    system = saltus.HybridSystem(states={"run": names}, flow={"run": lambda t, x, u, p: [0] * 2 * n},
                                 guards={"run": guards}, resets={"run": resets})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="run", initial=[0] * 2 * n, duration=2))
    assert len(motion.events) == 2 * n
    assert_allclose(motion.final, [1] * n + [0] * n)
    assert motion.remark == ""


def test_limits_are_arguments_and_are_named():
    # Counts down from n without time passing.
    counter = saltus.HybridSystem(
        states={"run": ["t", "n"]}, flow={"run": lambda t, x, u, p: [-1, 0]},
        guards={"run": {"down": lambda t, x, p: saltus.where(x[1] > 0.5, x[0], 1)}},
        resets={"run": {"down": lambda t, x, p: ("run", [saltus.where(x[1] > 1.5, -1, 1), x[1] - 1])}})

    def run(n, **limits):
        return saltus.rollout(saltus.HybridProblem(counter, mode="run", initial=[0.5, n], duration=1, **limits))

    assert len(run(90).events) == 90
    with pytest.raises(RuntimeError, match="more than 100 events without time passing .* of guard 'down': raise most_repeats"):
        run(150)
    assert len(run(150, most_repeats=200).events) == 150
    with pytest.raises(RuntimeError, match="more than 20 events, .* of guard 'down': raise most_events"):
        run(90, most_events=20)
    with pytest.raises(ValueError, match="most_repeats: expected a number of at least 1"):
        run(1, most_repeats=0)
    with pytest.raises(TypeError, match="most_events: found float, expected a whole number"):
        run(1, most_events=1.5)


def remark_of_a_solve(flow, reset, guard, initial):
    """A control on two intervals, a jump between them at t = 1 that the solver keeps, and an event at t = 1.0004."""
    system = saltus.HybridSystem(
        states={"m": ["y", "v", "z"]}, controls=["u"], flow={"m": flow}, guards={"m": {"hit": guard}}, resets={"m": {"hit": reset}})
    problem = saltus.HybridProblem(system, mode="m", initial=initial, duration=2.0, control=[[1.0], [2.0]],
                                   costs=[saltus.residuals(lambda x: [x[2] - 3.0]), saltus.effort(1e-6)])
    return saltus.solve(problem, solver="ceres_lm", optimize=["control"], iterations=1).reason


@pytest.mark.parametrize("flow, reset, kink", [
    (lambda x, u: [x[1], 0, u[0]], lambda x: ("m", [0, -x[1], x[2]]), False),  # the control acts on what does not strike
    (lambda x, u: [x[1], 0, u[0]], lambda x: ("m", [0, -x[1], 0.5 * x[2]]), True),  # what it acts on is reset
])
def test_an_event_near_a_jump_of_the_control(flow, reset, kink):
    reason = remark_of_a_solve(flow, reset, lambda x: x[0], [1.0004, -1.0, 0.0])
    assert ("where the control jumps and the loss has a kink" in reason) == kink, reason


def thrown_ball(apex, reset=lambda x: x):
    """A ball with drag v|v| that bounces; its apex, where the drag has its switch, may end a separate mode."""
    flow = lambda x, u, p: [x[1], -9.81 - p[0] * x[1] * abs(x[1]) + u[0]]
    modes = ("up", "down") if apex else ("up",)
    guards = {"down": {"ground": lambda x: x[0]}, "up": {"apex": lambda x: x[1]} if apex else {"ground": lambda x: x[0]}}
    resets = {"down": {"ground": lambda x: ("up", [x[0], -0.8 * x[1]])},
              "up": {"apex": lambda x: ("down", reset(x))} if apex else {"ground": lambda x: ("up", [x[0], -0.8 * x[1]])}}
    system = saltus.HybridSystem(states={mode: ["y", "v"] for mode in modes}, controls=["a"], parameters=["c"],
                                 flow={mode: flow for mode in modes}, guards={mode: guards[mode] for mode in modes},
                                 resets={mode: resets[mode] for mode in modes})
    return saltus.HybridProblem(system, mode="up", initial=[0.1, 5.0], parameters=[0.1], duration=1.5,
                                control=np.zeros((6, 1)), costs=[saltus.terminal([1.0, None]), saltus.effort(0.01)])


def test_a_guard_that_is_the_switch_of_the_flow_has_one_event_and_the_derivatives_of_the_motion_without_it():
    with_apex = saltus.loss_and_gradient(thrown_ball(apex=True))
    without = saltus.loss_and_gradient(thrown_ball(apex=False))
    assert with_apex.remark == ""
    assert_allclose(with_apex.loss, without.loss, rtol=1e-10)
    assert_allclose(with_apex.gradient["control"], without.gradient["control"], rtol=1e-9)
    assert_allclose(with_apex.gradient["initial"], without.gradient["initial"], rtol=1e-9)
    events = saltus.rollout(thrown_ball(apex=True)).events
    assert [event[2] for event in events] == ["apex", "ground", "apex"]


@pytest.mark.parametrize("speed", [3.0, 5.0, 5.37])  # after which rounding leaves the velocity above zero, or at zero
@pytest.mark.parametrize("condition", [lambda v: v > 0, lambda v: v >= 0, lambda v: v < 0])
def test_a_reset_that_jumps_at_its_own_event_has_a_remark(speed, condition):
    problem = thrown_ball(apex=True, reset=lambda x: [x[0] + saltus.where(condition(x[1]), 0.1, 0.0), x[1]])
    problem.initial = [0.1, speed]
    assert "the reset of guard 'apex' jumps at its event at t = " in saltus.rollout(problem).remark
    # A condition on a number that is away from its jump is no reason for a remark.
    beside = thrown_ball(apex=True, reset=lambda x: [x[0] + saltus.where(condition(x[1] - 1), 0.1, 0.0), x[1]])
    assert saltus.rollout(beside).remark == ""


@pytest.mark.parametrize("solver", ["ceres_phases", "auto"])
def test_phases_may_end_at_a_guard_that_is_the_switch_of_the_flow(solver):
    with_apex = saltus.solve(thrown_ball(apex=True), solver=solver)
    without = saltus.solve(thrown_ball(apex=False), solver=solver)
    assert with_apex.termination == "converged", with_apex.reason
    assert with_apex.loss <= without.loss * (1 + 1e-8)


def test_a_switch_where_the_control_jumps_is_a_switch_and_no_jump_of_the_mode():
    system = saltus.HybridSystem(states={"m": ["x", "y"]}, controls=["u"],
                                 flow={"m": lambda x, u: [1, saltus.where(x[0] > 0.5, 2 * x[0], x[0]) + u[0]]})
    problem = saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1.0, control=[[0.1], [0.3]],
                                   costs=[saltus.terminal([None, 1.0])], optimize=["control", "x"])
    assert_allclose(saltus.rollout(problem).final, [1, 0.125 + 0.75 + 0.2], rtol=1e-12)
    for solver in ("ceres_phases", "auto"):
        run = saltus.solve(problem, solver=solver)
        assert run.termination == "converged" and "control jump" not in run.reason


SIGNS = {
    "two switches": (["x", "y"], lambda x: [-2 - np.sign(x[0]), -2 - np.sign(x[1])], [1, 1], 1.0, np.eye(2) / 3),
    "three switches": (["x", "y", "z"], lambda x: [-2 - np.sign(x[i]) for i in range(3)], [1, 1, 1], 1.0, np.eye(3) / 3),
    "other slopes": (["x", "y"], lambda x: [-2 - np.sign(x[0]), -3 - np.sign(x[1])], [1, 4 / 3], 1.0, np.diag([1 / 3, 1 / 2])),
    "state and time": (["x", "y"], lambda t, x: [-1 - 0.5 * np.sign(x[0]), saltus.where(t > 0.5, 1, 3)], [0.75, 0], 1.0,
                       np.diag([1 / 3, 1])),
    "one surface twice": (["x"], lambda x: [-3 - np.sign(x[0]) - saltus.where(2 * x[0] > 0, 1, 0)], [1], 1.0, [[2 / 5]]),
}


@pytest.mark.parametrize("case", SIGNS)
def test_switches_that_turn_at_one_time_have_the_derivatives_of_each(case):
    states, flow, initial, duration, expected = SIGNS[case]
    system = saltus.HybridSystem(states={"m": states}, flow={"m": flow})
    problem = saltus.HybridProblem(system, mode="m", initial=initial, duration=duration)
    found = saltus.final_derivatives(problem)
    assert found.remark == ""
    assert_allclose(found.by_initial, expected, atol=1e-12)


def test_two_blocks_that_turn_at_one_time_are_solved_as_each_alone():
    def problem(blocks):
        names = [f"{name}{i}" for i in range(blocks) for name in "qv"]
        flow = lambda x, u: [rate for i in range(blocks) for rate in (x[2 * i + 1], u[i] - np.sign(x[2 * i + 1]))]
        system = saltus.HybridSystem(states={"m": names}, controls=[f"u{i}" for i in range(blocks)], flow={"m": flow})
        return saltus.HybridProblem(system, mode="m", initial=[0, 1] * blocks, duration=1.0, control=-2 * np.ones((6, blocks)),
                                    costs=[saltus.terminal([-0.5, None] * blocks), saltus.effort(0.01)])

    alone, both = saltus.loss_and_gradient(problem(1)), saltus.loss_and_gradient(problem(2))
    for i in range(2):
        assert_allclose(both.gradient["control"][:, i], alone.gradient["control"][:, 0], atol=1e-10)
    runs = [saltus.solve(problem(blocks), solver="ceres_phases") for blocks in (1, 2)]
    assert [run.termination for run in runs] == ["converged"] * 2
    assert_allclose(runs[1].loss, 2 * runs[0].loss, rtol=1e-8)


@pytest.mark.parametrize("restitution", np.linspace(0.08, 0.86, 27))
def test_a_ball_comes_to_rest_where_its_bounces_accumulate(restitution):
    ball = saltus.HybridSystem(
        states={"air": ["y", "v"], "rest": ["y", "v"]}, parameters=["e"],
        flow={"air": lambda x: [x[1], -9.81], "rest": lambda x: [0, 0]}, guards={"air": {"ground": lambda x: x[0]}},
        resets={"air": {"ground": lambda x, p: ("air", [0, -p[0] * x[1]])}}, on_accumulation={"air": {"ground": "rest"}})
    accumulated = math.sqrt(2 / 9.81) * (1 + restitution) / (1 - restitution)
    for part in (1.01, 1.7, 5):
        found = saltus.rollout(saltus.HybridProblem(ball, mode="air", initial=[1, 0], parameters=[restitution],
                                                    duration=part * accumulated))
        assert found.mode == "rest"
        assert_allclose(found.final, [0, 0], atol=1e-9)
        assert_allclose(found.events[-1][0], accumulated, rtol=1e-6)


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1, 1)])
def test_blocks_that_come_to_rest_at_one_time(signs):
    # Each rests on its switch from t = 1 on, at v0 |v0| / (2 mu); z counts the directions of those that still move.
    n = len(signs)
    weights = [1.0, 3.0, 5.0][:n]

    def flow(t, x, p):
        moves = [np.sign(v) for v in x[:n]]
        return [-p[i] * moves[i] for i in range(n)] + list(x[:n]) + [sum(w * s for w, s in zip(weights, moves))]

    blocks = saltus.HybridSystem(states={"m": [f"v{i}" for i in range(n)] + [f"x{i}" for i in range(n)] + ["z"]},
                                 parameters=[f"mu{i}" for i in range(n)], flow={"m": flow})
    mu = np.array([0.5, 1.0, 2.0])[:n]
    v = np.array(signs) * mu
    problem = saltus.HybridProblem(blocks, mode="m", initial=[*v, *[0] * (n + 1)], parameters=mu, duration=2.0)
    found, motion = saltus.final_derivatives(problem), saltus.rollout(problem)
    assert found.remark == motion.remark == ""
    assert [time for time, _, _ in motion.switches] == pytest.approx([1] * n)
    assert_allclose(motion.final, [*[0] * n, *(0.5 * v), np.dot(weights, signs)], atol=1e-12)
    assert_allclose(found.by_initial[:n], 0, atol=1e-12)
    assert_allclose(found.by_initial[n:-1, :n], np.diag(np.abs(v) / mu), atol=1e-12)
    assert_allclose(found.by_parameters[n:-1], np.diag(-v * np.abs(v) / (2 * mu**2)), atol=1e-12)
    assert_allclose(found.by_initial[-1, :n], weights / mu, atol=1e-12)
    assert_allclose(found.by_parameters[-1], -np.array(weights) * v / mu**2, atol=1e-12)


def test_a_guard_and_a_switch_at_one_time_have_derivatives_of_their_own():
    for falls, by_b in ((lambda b: -np.where(b > 0, 1, 2.0), 2), (lambda b: -np.sign(b), 0)):
        system = saltus.HybridSystem(
            states={"m": ["a", "b", "z"]}, flow={"m": lambda x, falls=falls: [-1, falls(x[1]), np.sign(x[1])]},
            guards={"m": {"g": lambda x: x[0]}}, resets={"m": {"g": lambda x: ("m", [x[0] + 5, x[1], x[2]])}})
        found = saltus.final_derivatives(saltus.HybridProblem(system, mode="m", initial=[1, 1, 0], duration=2))
        assert found.remark == ""
        assert_allclose(found.by_initial, [[1, 0, 0], [0, by_b, 0], [0, 1 if by_b == 0 else 2, 1]], atol=1e-12)


@pytest.mark.parametrize("flow, next_control", [(lambda x, u: [u[0], np.where(x[0] > 0, 1, 0 * x[0])], -1.0),
                                                (lambda x, u: [u[0] + 0.3 * np.sign(x[0]), x[0]], 0.0)])
def test_a_switch_that_is_touched_where_the_control_jumps_back(flow, next_control):
    system = saltus.HybridSystem(states={"m": ["x", "y"]}, controls=["u"], flow={"m": flow})
    start = -1.0 if next_control < 0 else -0.7
    problem = saltus.HybridProblem(system, mode="m", initial=[start, 0], control=[[1], [next_control]], duration=2)
    found = saltus.final_derivatives(problem)
    assert found.remark == "switch 'x' grazes zero at t = 1"
    # The derivative is that of motions that do not reach the switch.
    ends = []
    for less in (1e-6, 2e-6):
        problem.initial = [start - less, 0]
        ends.append(saltus.rollout(problem).final)
    assert_allclose(found.by_initial[:, 0], (ends[0] - ends[1]) / 1e-6, atol=1e-8)


def test_a_guard_that_is_its_switch_where_the_control_jumps():
    flow = lambda force: lambda x, u: [x[1], u[0] + force - x[1] * abs(x[1])]
    system = saltus.HybridSystem(states={m: ["x", "v"] for m in ("up", "down")}, controls=["u"],
                                 flow={"up": flow(0), "down": flow(-1)}, guards={"up": {"apex": lambda x: x[1]}},
                                 resets={"up": {"apex": lambda x: ("down", x)}})
    problem = saltus.HybridProblem(system, mode="up", initial=[0, math.tan(0.5)], control=[[-1], [-2.0]], duration=1)
    assert saltus.final_derivatives(problem).remark == "guard 'apex' has an event at t = 0.5, where the control jumps"


KINKS = {"abs": (lambda t, x, p: abs(x[1] + 2), True), "max": (lambda t, x, p: np.maximum(x[2], x[1] + 2), True),
         "of a parameter": (lambda t, x, p: abs(p[0] - 0.5), True), "of the time": (lambda t, x, p: np.minimum(t, 2), True),
         "beside the event": (lambda t, x, p: abs(x[1] + 2.001), False), "smooth": (lambda t, x, p: abs(x[1]), False),
         "of the guard": (lambda t, x, p: abs(x[0]), False), "smooth at zero": (lambda t, x, p: np.maximum(x[1] + 2, 0) ** 2, False)}


def landing(kink, **options):
    system = saltus.HybridSystem(
        states={"m": ["y", "v", "z"]}, parameters=["e"], flow={"m": lambda t, x, p: [x[1], -1, 0]},
        guards={"m": {"hit": lambda t, x, p: x[0]}},
        resets={"m": {"hit": lambda t, x, p: ("m", [x[0], -p[0] * x[1], KINKS[kink][0](t, x, p)])}})
    return saltus.HybridProblem(system, mode="m", initial=[2, 0, 0], parameters=[0.5], duration=2.5, **options)


@pytest.mark.parametrize("kink", KINKS)
def test_a_reset_with_a_kink_at_its_event_has_a_remark(kink):
    remark = saltus.final_derivatives(landing(kink)).remark
    expected = "the reset of guard 'hit' has a kink at its event at t = 2: its derivatives differ from side to side"
    assert remark == (expected if KINKS[kink][1] else "")


def test_batches_and_final_states_tell_their_remarks():
    problem = landing("abs", costs=[saltus.terminal([0, 0, 0])])
    batch = saltus.HybridBatch(problem, optimize=["initial"])
    remark = saltus.final_derivatives(problem).remark
    with pytest.warns(RuntimeWarning, match="2 of 3 gradients have remarks; that of point 0: the reset of guard 'hit'"):
        batch.loss_and_gradient([[2, 0, 0], [2.1, 0, 0], [2, 0, 1]])
    assert batch.remarks == {0: remark, 2: remark}
    batch.loss_and_gradient([[2.1, 0, 0]])
    assert batch.remarks == {}
    end = saltus.HybridEndState(problem)
    with pytest.warns(RuntimeWarning, match="the reset of guard 'hit' has a kink"):
        end.vjp(end.initial, end.control, end.parameters, [1, 1, 1])


TIED = {"states": (lambda x, u, p: x[0], lambda x, u, p: x[1]), "parameters": (lambda x, u, p: p[0], lambda x, u, p: p[1]),
        "a state and a parameter": (lambda x, u, p: x[3], lambda x, u, p: p[0]), "controls": (lambda x, u, p: u[0], lambda x, u, p: u[1]),
        "apart": (lambda x, u, p: x[0] + 2, lambda x, u, p: x[1]), "one number twice": (lambda x, u, p: 2 * x[0] - x[0], lambda x, u, p: x[0]),
        "friction of a force": (lambda x, u, p: 0.3 * np.maximum(0, p[0] + 1), lambda x, u, p: -5 + 0 * x[1])}
CHOICES = {"max": np.maximum, "min": np.minimum, "abs": lambda f, g: abs(f - g), "where": lambda f, g: np.where(f > g, 2 * f - g, f),
           "jump": lambda f, g: np.where(f > g, 1, 2), "clip": lambda f, g: np.minimum(np.maximum(f - g, 0), 1),
           "smooth square": lambda f, g: np.maximum(f - g, 0) ** 2, "smooth product": lambda f, g: (f - g) * abs(f - g),
           "multiplied by zero": lambda f, g: 0 * np.maximum(f, g) + f, "sum of both": lambda f, g: np.maximum(f, g) + np.minimum(f, g)}


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("tied", TIED)
def test_a_choice_between_numbers_that_stay_equal_has_a_remark_where_it_matters(tied, choice):
    f, g = TIED[tied]
    system = saltus.HybridSystem(
        states={"m": ["x", "y", "z", "c"]}, parameters=["a", "b"], controls=["u", "w"],
        flow={"m": lambda x, u, p: [-0.3 * x[0], -0.3 * x[1], CHOICES[choice](f(x, u, p), g(x, u, p)), 0]})
    values = np.array([0.7, 0.7, 0.2, 0.7, 0.7, 0.7, 0.7, 0.7, 0.7, 0.7])  # states, parameters, two intervals of the control

    def problem(at):
        return saltus.HybridProblem(system, mode="m", initial=at[:4], parameters=at[4:6], control=at[6:].reshape(2, 2), duration=1.3)

    found = saltus.final_derivatives(problem(values))
    assert found.remark == saltus.rollout(problem(values)).remark
    exact = np.hstack([found.by_initial, found.by_parameters, np.reshape(found.by_control, (4, 4))])
    end, step = saltus.rollout(problem(values)).final, 1e-6
    sides = [np.transpose([(saltus.rollout(problem(values + side * unit)).final - end) / side for unit in np.eye(10)])
             for side in (step, -step)]
    differ = any(np.abs(side - exact).max() > 1e-4 for side in sides)
    assert differ == (found.remark != "")
    if differ and choice != "jump":
        assert "the flow is not smooth at t = 0, where" in found.remark and "derivatives differ from side to side" in found.remark


def test_a_guard_that_is_the_smaller_of_two_numbers_that_stay_equal():
    for rates, remark in (((-1, -1), "guard 'hit' is not smooth at t = 1, where 'x - y' stays zero: derivatives differ from side to side"),
                          ((-1, -0.5), "")):
        system = saltus.HybridSystem(
            states={"m": ["x", "y"]}, flow={"m": lambda x, rates=rates: list(rates)}, guards={"m": {"hit": lambda x: np.minimum(x[0], x[1])}},
            resets={"m": {"hit": lambda x: ("m", [x[0] + 3, x[1] + 5])}})
        problem = saltus.HybridProblem(system, mode="m", initial=[1, 1], duration=1.7)
        assert saltus.final_derivatives(problem).remark == remark
        batch = saltus.HybridBatch(saltus.HybridProblem(system, mode="m", initial=[1, 1], duration=1.7, costs=[saltus.terminal([0, 0])]),
                                   optimize=["initial"])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            batch.loss_and_gradient([[1, 1], [1, 1.1]])
        assert batch.remarks == ({0: remark} if remark else {})
