"""Conditions in functions of hybrid systems: where the flow jumps or has a kink, guards that touch zero, accuracy."""

import math

import numpy as np
import pytest
from conftest import load_campaign
from numpy.testing import assert_allclose

import saltus


def one_mode(flow, states=("x",), parameters=(), **rest):
    return saltus.HybridSystem(states={"m": list(states)}, parameters=list(parameters), flow={"m": flow}, **rest)


def derivatives(system, initial, parameters, duration, **options):
    problem = saltus.HybridProblem(system, mode="m", initial=initial, parameters=parameters, duration=duration, **options)
    motion, d = saltus.rollout(problem), saltus.final_derivatives(problem)
    assert motion.remark == d.remark == ""
    assert motion.integration_error <= 1e-12 and d.integration_error == motion.integration_error
    return motion, d


@pytest.mark.parametrize("tolerance", [1e-4, 1e-12])
def test_a_jump_by_the_state(tolerance):
    system = one_mode(lambda t, x, u, p: [saltus.where(x[0] < p[0], 1.0, 3.0)], parameters=["c"])
    motion, d = derivatives(system, [0.3], [1.0], 2.0, tolerance=tolerance)
    assert_allclose(motion.final, [4.9], rtol=1e-14)
    assert_allclose([d.by_initial[0, 0], d.by_parameters[0, 0], d.by_duration[0]], [3, -2, 3], rtol=1e-13)
    assert motion.events == [] and [(mode, number) for _, mode, number in motion.switches] == [("m", "x - c")]
    assert d.times_by_initial.shape == (0, 1)


@pytest.mark.parametrize(
    "chosen",
    [
        lambda x, c: [np.where(x[0] < c, 1.0, 3.0)],
        lambda x, c: np.where(x < c, 1.0, 3.0),
        lambda x, c: [np.select([x[0] < c, x[0] < 9], [1.0, 3.0], 5.0)],
    ],
)
def test_choices_of_numpy_are_recorded(chosen):
    motion, d = derivatives(one_mode(lambda t, x, u, p: chosen(x, p[0]), parameters=["c"]), [0.3], [1.0], 2.0)
    assert_allclose(motion.final, [4.9], rtol=1e-14)
    assert_allclose([d.by_initial[0, 0], d.by_parameters[0, 0]], [3, -2], rtol=1e-13)


def test_choices_of_numbers_are_those_of_numpy():
    def flow(t, x, u, p):
        (places,) = np.where(np.array([0.0, 2.0]) > 1)
        return [x[0] * 0 + places[0] + np.where(3 > 2, 1.0, 5.0) + np.select([np.array(False)], [2.0], 4.0)]

    motion, _ = derivatives(one_mode(flow), [0.0], [], 1.0)
    assert_allclose(motion.final, [6.0], rtol=1e-14)


def test_a_jump_by_the_time():
    system = one_mode(lambda t, x, u, p: [-x[0] + saltus.where(t < p[0], 1.0, 0.0)], parameters=["off"])
    motion, d = derivatives(system, [0.0], [1.0], 2.0)
    assert_allclose(motion.final, [math.exp(-1) * (1 - math.exp(-1))], rtol=1e-12)  # the tolerance of the integration
    assert_allclose(d.by_parameters, [[math.exp(-1)]], rtol=1e-11)


def test_a_box_that_comes_to_rest_stays():
    system = one_mode(lambda t, x, u, p: [x[1], -p[0] * np.sign(x[1])], ["x", "v"], ["f"])
    motion, d = derivatives(system, [0, 10], [2.94], 5.0)
    assert_allclose(motion.final, [100 / 5.88, 0], rtol=1e-13, atol=1e-13)
    assert_allclose(d.by_initial, [[1, 10 / 2.94], [0, 0]], atol=1e-13)
    assert_allclose(d.by_parameters, [[-50 / 2.94**2], [0]], rtol=1e-13, atol=1e-13)


def test_a_spring_on_one_side():
    system = one_mode(lambda t, x, u, p: [x[1], saltus.where(x[0] < 0, -p[0] * x[0], 0.0)], ["x", "v"], ["k"])
    motion, d = derivatives(system, [1.0, -1.3], [50.0], 3.0)
    w = math.sqrt(50)
    assert_allclose(motion.final, [1.3 * (3 - 1 / 1.3 - math.pi / w), 1.3], rtol=1e-12)
    assert_allclose(d.by_initial, [[-1, -(3 - math.pi / w)], [0, -1]], atol=1e-11)


def test_quadratic_drag_has_the_derivatives_of_its_closed_form():
    """Up: v = k tan(...), down: tanh; values of 15 digits from tests of the two halves as modes of their own."""
    system = one_mode(lambda t, x, u, p: [x[1], -9.81 - p[0] * x[1] * abs(x[1])], ["y", "v"], ["c"])
    motion, d = derivatives(system, [0, 20], [0.05], 3.0)
    k = math.sqrt(9.81 / 0.05)
    top = math.atan(20 / k) / math.sqrt(9.81 * 0.05)
    height = math.log(1 + 400 / k**2) / (2 * 0.05)
    down = math.sqrt(9.81 * 0.05) * (3 - top)
    assert_allclose(motion.final, [height - math.log(math.cosh(down)) / 0.05, -k * math.tanh(down)], rtol=1e-11)
    assert_allclose(d.by_parameters.ravel(), [-135.835066797112, 37.352838119984], rtol=1e-9)


@pytest.mark.parametrize("rate, final", [
    (lambda t, c: np.floor(c * t), 1.3), (lambda t, c: (c * t) % 1.0, 0.66), (lambda t, c: c * t // 1, 1.3),
    (lambda t, c: np.maximum(t - c / 2, 0), 0.08), (lambda t, c: np.minimum(c * t, 1), 1.15), (lambda t, c: abs(t - c / 2), 0.58),
    (lambda t, c: np.clip(t, c / 4, c / 2), 0.25 + 0.375 + 0.4), (lambda t, c: np.sign(t - c / 4), 0.4), (lambda t, c: (t > c / 4) * 1.0, 0.9),
    (lambda t, c: np.round(c * t), 1.95), (lambda t, c: round(c * t), 1.95), (lambda t, c: np.trunc(1.5 - c * t), 0.1),
    (lambda t, c: np.ceil(c * t), 2.7), (lambda t, c: math.copysign(1.0, t - c / 4), 0.4), (lambda t, c: math.fabs(t - c / 2), 0.58),
    (lambda t, c: saltus.where((t > c / 4) & ~(t > c / 2), 1.0, 0.0), 0.5),
    (lambda t, c: saltus.where((t > c / 4) ^ (t > c / 2), 1.0, 0.0), 0.5),
    (lambda t, c: saltus.where((t > c / 4) == (t > c / 2), 0.0, 1.0), 0.5),
    (lambda t, c: saltus.where((t > c / 4) != (t > c / 2), 1.0, 0.0), 0.5),
])
def test_functions_with_jumps_and_kinks(rate, final):
    """x' is a function of the time, with c = 2 until 1.4; derivatives against differences of the integral."""
    system = one_mode(lambda t, x, u, p: [rate(t, p[0])], parameters=["c"])
    motion, d = derivatives(system, [0.0], [2.0], 1.4)
    assert_allclose(motion.final, [final], rtol=1e-12)
    ends = [saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.0], parameters=[c], duration=1.4)).final[0]
            for c in (2 - 1e-4, 2 + 1e-4)]
    assert_allclose(d.by_parameters[0, 0], (ends[1] - ends[0]) / 2e-4, atol=1e-7)


@pytest.mark.parametrize("test, first", [
    (lambda c: c & True, False), (lambda c: True & c, False), (lambda c: c & np.bool_(True), False),
    (lambda c: c & False, False), (lambda c: False & c, False), (lambda c: c | True, True), (lambda c: np.True_ | c, True),
    (lambda c: c | False, False), (lambda c: c ^ True, True), (lambda c: c ^ False, False), (lambda c: ~c, True),
    (lambda c: c == True, False), (lambda c: c == False, True), (lambda c: c != True, True),  # noqa: E712
    (lambda c: np.logical_and(c, True), False), (lambda c: np.logical_or(c, False), False), (lambda c: np.logical_not(c), True),
    (lambda c: np.logical_xor(c, True), True), (lambda c: c & ~c, False),
])
def test_conditions_with_truth_values(test, first):
    system = one_mode(lambda t, x, u, p: [saltus.where(test(x[0] > 0.5), 1.0, -1.0)])
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.0], duration=0.25))
    assert_allclose(motion.final, [0.25 if first else -0.25])


@pytest.mark.parametrize("condition", [lambda x: (x > 0) & 1.0, lambda x: (x > 0) | x, lambda x: x])
def test_a_number_in_the_place_of_a_condition_is_refused(condition):
    with pytest.raises(TypeError, match="flow of mode 'm': found a"):
        one_mode(lambda t, x, u, p: [saltus.where(condition(x[0]), 1.0, -1.0)])


def test_a_comparison_with_a_state_that_stays_what_it_is():
    """A counter in the state: equality holds while it does, and has no derivative by the counter at the start."""
    system = one_mode(
        lambda t, x, u, p: [saltus.where(x[1] == 2, 1.0, saltus.where(x[1] > 2, 10.0, 0.0)), 0], ["x", "n"],
        guards={"m": {"tick": lambda t, x, p: 0.1 * (x[1] + 1) - t}},
        resets={"m": {"tick": lambda t, x, p: ("m", [x[0], x[1] + 1])}})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=0.39))
    assert_allclose(motion.final, [0.1 + 0.9, 3], rtol=1e-12)
    assert "leads onto switch 'n - 2'" in motion.remark


def test_a_motion_along_a_switch_ends_with_the_reason():
    system = one_mode(lambda t, x, u, p: [0.5 - np.sign(x[0])])
    with pytest.raises(RuntimeError, match="both sides of switch 'x' points at it .* at t = 2: .* a mode of its own"):
        saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[1.0], duration=3.0))


def test_a_motion_that_begins_on_a_switch_has_a_remark():
    system = one_mode(lambda t, x, u, p: [saltus.where(x[0] < 0, 1.0, 2.0)])
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.0], duration=1.0))
    assert_allclose(motion.final, [2.0]) and "begins on switch 'x'" in motion.remark
    kink = one_mode(lambda t, x, u, p: [1 + abs(x[0])])  # the flow does not jump
    assert saltus.rollout(saltus.HybridProblem(kink, mode="m", initial=[0.0], duration=1.0)).remark == ""


def falling(guard):
    return saltus.HybridSystem(
        states={"f": ["y", "v"]}, parameters=["e"], flow={"f": lambda t, x, u, p: [x[1], -9.81]},
        guards={"f": {"ground": guard}}, resets={"f": {"ground": lambda t, x, p: ("f", [0, -p[0] * x[1]])}})


@pytest.mark.parametrize("guard", [lambda t, x, p: x[0] < 0, lambda t, x, p: [x[0] < 0], lambda t, x, p: ~(x[0] < 0), lambda t, x, p: True])
def test_a_condition_as_a_guard_is_refused(guard):
    with pytest.raises(TypeError, match="guard 'ground' of mode 'f': found a condition; a guard is a number that falls through zero"):
        falling(guard)


@pytest.mark.parametrize("guard", [lambda t, x, p: x[0], lambda t, x, p: np.sign(x[0]), lambda t, x, p: np.minimum(x[0], 1),
                                   lambda t, x, p: saltus.where(x[0] > 0, x[0], x[0] - 1)])
def test_guards_that_fall_through_zero(guard):
    problem = saltus.HybridProblem(falling(guard), mode="f", initial=[1.3, 0.4], parameters=[0.8], duration=2.0)
    assert_allclose(saltus.rollout(problem).final, [0.134618237525133, -2.80563429187713], rtol=1e-11)
    assert_allclose(saltus.final_derivatives(problem).by_parameters.ravel(), [7.89517419, 18.23818412], rtol=1e-8)


@pytest.mark.parametrize("guard", [lambda t, x, p: abs(x[0]), lambda t, x, p: np.maximum(x[0], 0), lambda t, x, p: x[0] ** 2])
def test_guards_that_touch_zero_have_a_remark(guard):
    problem = saltus.HybridProblem(falling(guard), mode="f", initial=[1.3, 0.4], parameters=[0.8], duration=2.0)
    motion = saltus.rollout(problem)
    assert motion.events == []
    assert "guard 'ground' grazes zero at t = 0.557" in motion.remark and "touches zero and returns" in motion.remark


def test_a_remainder_as_a_guard_has_a_remark():
    ticks = one_mode(lambda t, x, u, p: [-x[0]], guards={"m": {"tick": lambda t, x, p: t % 0.1}},
                     resets={"m": {"tick": lambda t, x, p: ("m", [x[0] + 0.2])}})
    motion = saltus.rollout(saltus.HybridProblem(ticks, mode="m", initial=[1], duration=0.95))
    assert "guard 'tick' grazes zero at t = 0.1 and 8 more times" in motion.remark


def test_remarks_beyond_the_first_are_counted():
    guards = {f"touch_{i:02}": lambda t, x, p, at=0.1 + i / 25: (t - at) ** 2 for i in range(20)}
    system = one_mode(lambda t, x, u, p: [-x[0]], guards={"m": guards}, resets={"m": {name: lambda x: ("m", [x[0]]) for name in guards}})
    remark = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[1], duration=1.0)).remark
    assert "touch_00" in remark and "touch_07" in remark and "touch_08" not in remark
    assert remark.endswith("; and 12 more such remarks")


def test_steps_that_are_too_few_have_a_remark():
    system = one_mode(lambda t, x, u, p: [x[1], -p[0] * x[0]], ["x", "v"], ["stiffness"])  # integrated, not flown
    problem = saltus.HybridProblem(system, mode="m", initial=[1, 0], parameters=[1.0], duration=20.0, steps_per_interval=16)
    motion = saltus.rollout(problem)
    error = np.max(np.abs(motion.final - [math.cos(20), -math.sin(20)]))
    assert 1e-9 < error < 2 * motion.integration_error
    assert "above the tolerance 1e-12" in motion.remark


@pytest.mark.parametrize("width", [1e-2, 1e-3, 3e-4])
def test_a_pulse_in_time_within_a_step_is_seen(width):
    system = one_mode(lambda t, x, p: [np.exp(-((t - p[0]) / width) ** 2) / width], parameters=["time"])
    motion, d = derivatives(system, [0.0], [7.3], 10.0)
    assert_allclose(motion.final, [math.sqrt(math.pi)], rtol=1e-11)
    assert_allclose(d.by_parameters, [[0.0]], atol=1e-9)


@pytest.mark.parametrize("width", [4e-2, 1e-2])
def test_a_pulse_along_the_motion_within_a_step_is_seen(width):
    system = one_mode(lambda x: [1 + 20 * np.exp(-((x[0] - 3) / width) ** 2)])
    motion, _ = derivatives(system, [0.0], [], 10.0)
    s = np.linspace(-9, 9, 2001)  # the rule of trapezoids has no error for such functions
    saved = np.sum(1 - 1 / (1 + 20 * np.exp(-s**2))) * (s[1] - s[0]) * width
    assert_allclose(motion.final, [10 + saved], rtol=1e-11)


@pytest.mark.parametrize("width", [1e-2, 1e-3, 3e-4])
def test_a_guard_that_falls_and_returns_within_a_step_has_its_event(width):
    system = saltus.HybridSystem(
        states={"before": ["x"], "after": ["x"]}, flow={"before": lambda: [1.0], "after": lambda: [3.0]},
        guards={"before": {"g": lambda t: 1 - 2 * np.exp(-((t - 7.3) / width) ** 2)}},
        resets={"before": {"g": lambda x: ("after", x)}})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="before", initial=[0.0], duration=10.0))
    event = 7.3 - width * math.sqrt(math.log(2))
    assert_allclose([time for time, *_ in motion.events], [event], rtol=1e-12)
    assert_allclose(motion.final, [30 - 2 * event], rtol=1e-12)


PULSES = {  # with their integrals over all numbers
    "gauss": (lambda z: np.exp(-z * z), math.sqrt(math.pi)),
    "sech": (lambda z: 1 / np.cosh(z), math.pi),
    "lorentz": (lambda z: 1 / (1 + z * z) ** 2, math.pi / 2),
    "where": (lambda z: saltus.where(np.exp(-z * z) > 0.5, 1.0, 0.0), 2 * math.sqrt(math.log(2))),
}


@pytest.mark.parametrize("kind", PULSES)
@pytest.mark.parametrize("width", [2e-5, 1e-6, 1e-7])
def test_a_pulse_that_is_much_narrower_than_the_steps_is_integrated(kind, width):
    pulse, integral = PULSES[kind]
    height = 3 / (integral * width)
    in_time = one_mode(lambda t: [height * pulse((t - 7.3) / width)])
    motion = saltus.rollout(saltus.HybridProblem(in_time, mode="m", initial=[0.0], duration=10.0))
    assert_allclose(motion.final, [3], rtol=1e-8)
    assert motion.remark == "" or "integration error" in motion.remark  # 7.3 has few digits more than the width
    if kind not in ("gauss", "sech") or width < 1e-6:  # a narrower one stops the motion within a few numbers
        return
    along = one_mode(lambda x: [1 / (1 + height * pulse((x[0] - 7.3) / width))])  # takes 3 s longer for the width
    motion = saltus.rollout(saltus.HybridProblem(along, mode="m", initial=[5.0], duration=10.0))
    assert_allclose(motion.final, [12], rtol=1e-6)


@pytest.mark.parametrize("kind", ["gauss", "sech", "lorentz"])
@pytest.mark.parametrize("base", [lambda t: 0.5, lambda t: 0.9 - 0.05 * t])
def test_a_dip_of_a_guard_that_is_much_narrower_than_the_steps_has_its_event(kind, base):
    pulse, width = PULSES[kind][0], 1e-7
    system = saltus.HybridSystem(
        states={"before": ["x"], "after": ["x"]}, flow={"before": lambda: [1.0], "after": lambda: [1.0]},
        guards={"before": {"g": lambda t: base(t) - pulse((t - 7.3) / width)}}, resets={"before": {"g": lambda x: ("after", x)}})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="before", initial=[0.0], duration=10.0))
    level = base(7.3)
    apart = {"gauss": math.sqrt(-math.log(level)), "sech": math.acosh(1 / level), "lorentz": math.sqrt(level**-0.5 - 1)}
    assert_allclose([time for time, *_ in motion.events], [7.3 - width * apart[kind]], rtol=1e-12)


def test_steps_that_are_chosen_by_the_user_and_miss_a_pulse_have_a_remark():
    system = one_mode(lambda t: [np.exp(-((t - 7.3) / 1e-6) ** 2) * 1e6])
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.0], duration=10.0, steps_per_interval=64))
    assert "the derivative of x changes faster than the steps resolve" in motion.remark
    assert math.isinf(motion.integration_error)


def test_a_quotient_of_numbers_that_vanish_together_is_no_pulse():
    """The neuron of Hodgkin and Huxley: quotients in the rates of its gates have no digits left near -40 and -55 mV."""
    def flow(x):
        V, m, h, n = x
        on_m, off_m = 0.1 * (V + 40) / (1 - np.exp(-(V + 40) / 10)), 4 * np.exp(-(V + 65) / 18)
        on_n, off_n = 0.01 * (V + 55) / (1 - np.exp(-(V + 55) / 10)), 0.125 * np.exp(-(V + 65) / 80)
        on_h, off_h = 0.07 * np.exp(-(V + 65) / 20), 1 / (1 + np.exp(-(V + 35) / 10))
        return [10 - 120 * m**3 * h * (V - 50) - 36 * n**4 * (V + 77) - 0.3 * (V + 54.387),
                on_m * (1 - m) - off_m * m, on_h * (1 - h) - off_h * h, on_n * (1 - n) - off_n * n]

    neuron = one_mode(flow, ["V", "m", "h", "n"])
    motion = saltus.rollout(saltus.HybridProblem(neuron, mode="m", initial=[-65, 0.05, 0.6, 0.32], duration=30.0))
    assert motion.remark == ""


@pytest.mark.parametrize("solver", ["ceres_lm", "ceres_lbfgs", "ceres_phases"])
def test_solvers_see_the_jump(solver):
    """An infusion until t = c, which no step of a solver takes beyond the end; x(2) is to be 0.75."""
    system = one_mode(lambda t, x, u, p: [saltus.where(t < p[0], 1.0, 0.0)], parameters=["c"])
    problem = saltus.HybridProblem(system, mode="m", initial=[0.0], parameters=[0.25], duration=2.0, costs=[saltus.terminal([0.75])])
    run = saltus.solve(problem, solver=solver, optimize=["c"])
    assert_allclose(run.parameters, [0.75], atol=1e-6)


@pytest.mark.parametrize("solver", ["ceres_phases", "ipopt", "mode_search"])
@pytest.mark.parametrize("by_state", [False, True])
def test_a_motion_that_begins_at_a_point_of_a_table_is_solved(solver, by_state):
    def solve(points, values):
        def flow(t, x, u, p):
            return [u[0] + saltus.interp(x[0] if by_state else t, points, values)]

        system = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": flow})
        costs = [saltus.terminal([1.0]), saltus.effort(1.0)]
        problem = saltus.HybridProblem(system, mode="m", initial=[0.0], control=np.ones((4, 1)), duration=1.0, costs=costs)
        return saltus.solve(problem, solver=solver)

    result = solve([0, 0.4, 2], [0.2, 1, 0])
    before_it = solve([-1, 0.4, 2], [-1.8, 1, 0])  # the same line
    assert result.termination == before_it.termination == "converged"
    assert_allclose(result.loss, before_it.loss, rtol=1e-7)
    if not by_state:
        area = 0.5 * (0.2 + 1) * 0.4 + 0.5 * (1 + 0.625) * 0.6
        assert_allclose(result.loss, 0.5 * (1 - area) ** 2, rtol=1e-9)


@pytest.mark.parametrize("optimize", [["c"], ["c", "x"]])
def test_a_solution_at_which_nothing_that_is_optimized_matters_has_not_converged(optimize):
    """An infusion until t = c > 1 lasts longer than the motion: the derivative by c is zero, and the loss 1/16."""
    system = one_mode(lambda t, x, u, p: [saltus.where(t < p[0], 1.0, 0.0)], parameters=["c"])
    problem = saltus.HybridProblem(system, mode="m", initial=[0.0], parameters=[0.25], duration=1.0, costs=[saltus.terminal([0.75])])
    run = saltus.solve(problem, solver="ceres_lbfgs", optimize=optimize)
    if optimize == ["c"]:
        assert run.loss == 0.0625 and run.termination == "no_progress"
        assert "no small change of what is optimized changes the motion" in run.reason
    else:
        assert run.loss < 1e-12 and run.termination == "converged"
    assert_allclose(saltus.solve(problem, optimize=["c"]).parameters, [0.75], atol=1e-9)  # auto


SCHEDULES = {  # of t, on a grid of length 1; "on" at a time is what the function itself says
    "parity of a counter": lambda t: np.floor(t) % 2 < 1,
    "two counters at once": lambda t: np.floor(t) - 2 * np.floor(t / 2) < 1,
    "counter of a counter": lambda t: np.floor(np.floor(t) / 3) % 2 < 1,
    "one in four": lambda t: np.floor(t) % 4 == 2,
    "none in four": lambda t: np.floor(t) % 4 != 1,
    "at most": lambda t: np.floor(t) % 3 <= 1,
    "sign of a counter": lambda t: np.sign(np.floor(t) - 2) <= 0,
    "distance of a counter": lambda t: abs(np.floor(t) - 3) < 2,
    "larger of two": lambda t: np.maximum(np.floor(t), 2) - np.floor(t) < 1,
    "remainder of a counter": lambda t: (0.5 * np.floor(t)) % 1 < 0.25,
    "integer of a sign": lambda t: np.floor(0.5 * np.sign(t - 3) + 0.75) < 1,
}


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_conditions_on_counters(schedule):
    """Numbers that jump where another switch changes: y' = 1 - y where the schedule is on, -y where it is off."""
    on = SCHEDULES[schedule]
    system = one_mode(lambda t, x, u, p: [saltus.where(on(t + p[0]), 1.0, 0.0) - x[0]], ["y"], ["delay"])
    for duration in (1.5, 4.5, 7.25):
        for delay in (0.0, 0.3):
            problem = saltus.HybridProblem(system, mode="m", initial=[0.2], parameters=[delay], duration=duration)
            y, t = 0.2, 0.0
            while t < duration:
                end = min(math.floor(t + delay + 1e-9) + 1 - delay, duration)
                level = float(bool(on(0.5 * (t + end) + delay)))
                y, t = level + (y - level) * math.exp(t - end), end
            assert_allclose(saltus.rollout(problem).final, [y], rtol=1e-11)
            if delay > 0:
                assert_allclose(saltus.final_derivatives(problem).by_initial, [[math.exp(-duration)]], atol=1e-11)


def test_conditions_on_a_side_of_the_state():
    """The number x + 2 sign(y) jumps through zero as y does: y falls, and x' is 1 where the number is above zero."""
    system = one_mode(lambda t, x, u, p: [saltus.where(x[0] + p[0] * np.sign(x[1]) > 0, 1.0, -0.5), -1.0], ["x", "y"], ["c"])
    problem = saltus.HybridProblem(system, mode="m", initial=[0.1, 0.7], parameters=[2.0], duration=2.0)
    assert_allclose(saltus.rollout(problem).final, [0.1 + 0.7 - 0.5 * 1.3, -1.3], rtol=1e-13)
    assert_allclose(saltus.final_derivatives(problem).by_initial, [[1, 1.5], [0, 1]], atol=1e-12)


def test_random_systems_agree_with_another_method():
    campaign = load_campaign("random_switched_systems")
    kinds = [campaign.compare(seed)[0] for seed in range(24)]
    assert "DIFFERS" not in kinds and kinds.count("agrees") >= 16, kinds


@pytest.mark.parametrize("speed, remark", [
    (lambda v: 0.0, ""),  # every motion nearby is left on the switch, too
    (lambda v: v + 3.0, "the reset at t = 0.25 leads onto switch 'v', where the flow jumps"),
])
def test_a_reset_onto_a_switch(speed, remark):
    system = one_mode(lambda t, x, u, p: [1.0, saltus.where(x[1] > 0, 1.0, -8.0)], ["s", "v"],
                      guards={"m": {"quarter": lambda t, x, p: 0.25 - x[0]}},
                      resets={"m": {"quarter": lambda t, x, p: ("m", [0, speed(x[1])])}})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.0, -1.0], duration=0.4))
    assert_allclose(motion.final, [0.15, -1.2], rtol=1e-12)
    assert motion.remark == remark


@pytest.mark.parametrize("sliding", [None, "filippov"])
def test_switches_that_accumulate_are_named(sliding):
    """A motion that winds around the point where two switches are zero, each time in a part of the time before."""
    system = one_mode(lambda t, x, u, p: [-np.sign(x[0]) + 2 * np.sign(x[1]), -2 * np.sign(x[0]) - np.sign(x[1])], ["a", "b"], sliding=sliding)
    with pytest.raises(RuntimeError, match=r"events accumulate \(Zeno behaviour\) at about t = 0.* of switch '[ab]' in mode 'm'; "
                                           "if they do not end, make the change of the flow gradual, or end the motion before$"):
        saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.4, 0.1], duration=4.0))


@pytest.mark.parametrize("sliding", [None, "filippov"])
@pytest.mark.parametrize("other, before, on, mean", [
    (lambda x: np.sign(x), 1, 0, 0), (lambda x: abs(x) * x / 0.09, None, 0, 0), (lambda x: np.sign(2 * x), 1, 0, 0),
    (lambda x: np.sign(-x), -1, 0, 0), (lambda x: np.sign(x**3), 1, 0, 0), (lambda x: np.sign(np.tanh(-x) / 3), -1, 0, 0),
    (lambda x: saltus.where(2 * x > 0, 1, -1), 1, -1, 0), (lambda x: saltus.where(-3 * x > 0, 0.5, -2), -2, -2, -0.75),
    (lambda x: abs(-2 * x) + np.sign(x), None, 0, 0)])
def test_two_conditions_for_one_surface(sliding, other, before, on, mean):
    """Multiples and odd powers are held with the number: x = 0 from t = x0 / a on, where y' is the value of the function,
    or by Filippov's convention the mean of both sides. Closed forms of the state and its derivatives."""
    system = one_mode(lambda t, x, u, p: [-p[0] * np.sign(x[0]), other(x[0])], ["x", "y"], ["a"], sliding=sliding)
    problem = saltus.HybridProblem(system, mode="m", initial=[0.3, 1.0], parameters=[1.5], duration=2.0)
    motion, d = saltus.rollout(problem), saltus.final_derivatives(problem)
    assert motion.remark == ""
    assert [name for _, _, name in motion.switches] == ["x"]
    after, stop = on if sliding is None else mean, 0.3 / 1.5
    if before is None:  # x^2 / 0.09 and 1 + 2 x until then
        y = stop / 3 if other(0.6) == 4 else stop + 0.3 * stop
        assert_allclose(motion.final, [0, 1 + y], atol=1e-12)
        return
    assert_allclose(motion.final, [0, 1 + before * stop + after * (2 - stop)], atol=1e-12)
    assert_allclose(d.by_initial, [[0, 0], [(before - after) / 1.5, 1]], atol=1e-12)
    assert_allclose(d.by_parameters[1], [(after - before) * stop / 1.5], atol=1e-12)


@pytest.mark.parametrize("sliding", [None, "filippov"])
@pytest.mark.parametrize("other", [lambda x: np.sign(np.sin(x)), lambda x: np.sign(x + x**3)])
def test_unlike_conditions_for_one_surface_are_named(sliding, other):
    system = one_mode(lambda t, x, u, p: [-np.sign(x[0]), -other(x[0])], ["x", "y"], sliding=sliding)
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.3, 1.0], duration=2.0))
    assert "the motion stays on switch 'x' at t = 0.3, where switch" in motion.remark
    assert "is zero as well but keeps its side: the motion may be wrong; write both conditions alike" in motion.remark


def test_a_tie_of_switches_is_called_one():
    system = one_mode(lambda t, x, u, p: [saltus.where(x[1] > 0, -1, -3), saltus.where(x[0] > 0, -1, -2)], ["x", "y"])
    d = saltus.final_derivatives(saltus.HybridProblem(system, mode="m", initial=[0.5, 0.5], duration=2.0))
    assert d.remark.startswith("2 switches reach zero at t = 0.5, and the derivatives depend on the order of their events: ")


def test_a_flow_that_is_not_smooth_is_refused_with_the_place():
    """v' = -1 - p sign(v) sqrt(|v|) through zero: the closed form t(v), which a larger tolerance reaches."""
    p, v0, duration = 0.5, 0.5, 1.0
    system = one_mode(lambda t, x, u, p: [x[1], -1 - p[0] * np.sign(x[1]) * np.sqrt(abs(x[1]))], ["x", "v"], ["p"])
    given = {"mode": "m", "initial": [0, v0], "parameters": [p], "duration": duration}
    message = r"twice as many lower the error only by a factor of [23].* in mode 'm' at t = 0\.40.*choose a larger tolerance"
    with pytest.raises(RuntimeError, match=message):
        saltus.rollout(saltus.HybridProblem(system, **given))
    final = saltus.rollout(saltus.HybridProblem(system, tolerance=1e-7, **given)).final[1]
    before = 2 / p * math.sqrt(v0) - 2 / p**2 * math.log(1 + p * math.sqrt(v0))
    after = -2 / p * math.sqrt(-final) - 2 / p**2 * math.log(1 - p * math.sqrt(-final))
    assert_allclose(before + after, duration, rtol=2e-6)


def test_a_tank_that_fills_from_empty_is_not_called_stiff():
    tank = one_mode(lambda x: [1 - 0.5 * np.sqrt(x[0])], ["h"])
    with pytest.raises(RuntimeError, match=r"twice as many lower the error only by a factor of 2.* in mode 'm' at t = 0, as sqrt"):
        saltus.rollout(saltus.HybridProblem(tank, mode="m", initial=[0], duration=2.0))


def test_a_motion_along_a_step_of_floor_ends_with_the_reason():
    system = one_mode(lambda x: [0.3 - np.floor(4 * x[0]) / 4], sliding="filippov")
    with pytest.raises(RuntimeError, match=r"points at it in mode 'm' at t = 2.7376.* and the switch is no step of floor or %"):
        saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[1.9], duration=20.0))


def test_tables_and_steps_are_recorded():
    """x' is k times a table of x, 1 + x to x = 1, 2 x to x = 2, and c beyond: closed forms. y' steps at t = s."""
    points = np.array([0.0, 1.0, 2.0])
    system = one_mode(lambda t, x, u, p: [p[0] * np.interp(x[0], points, [1.0, 2.0, p[1]]), np.heaviside(t - p[2], 0.5)],
                      ["x", "y"], ["k", "c", "s"])
    k, c, at = 0.8, 4.0, 0.7
    motion, d = derivatives(system, [0.2, 0.0], [k, c, at], 3.0)
    first = math.log(2 / 1.2) / k
    second = first + math.log(c / 2) / ((c - 2) * k)
    assert_allclose(motion.final, [2 + c * k * (3 - second), 3 - at], rtol=1e-12)
    by_c = k * (3 - second) - c * ((c - 2) / c - math.log(c / 2)) / (c - 2) ** 2
    assert_allclose(d.by_parameters, [[c * 3, by_c, 0], [0, 0, -1]], rtol=1e-9, atol=1e-12)
    assert_allclose(d.by_initial[0], [c / 1.2, 0], rtol=1e-10)


@pytest.mark.parametrize("table", [([0, 0], [1, 2]), ([0, 1], [1]), ([[0, 1]], [[1, 2]])])
def test_tables_that_are_none_are_refused(table):
    with pytest.raises(ValueError, match="numpy.interp: expected xp with increasing numbers, and as many values fp"):
        one_mode(lambda t, x, u, p: [np.interp(x[0], *table)])


@pytest.mark.parametrize("count", [2, 3, 4, 9])
def test_splines_are_those_of_scipy(count):
    """x' is a spline of time whose values are parameters, y' one of the state: integrals by scipy, and its splines of numbers."""
    interpolate = pytest.importorskip("scipy.interpolate")
    random = np.random.default_rng(3)
    points, values = np.cumsum(random.uniform(0.2, 0.5, count)), random.uniform(1, 1.5, count)
    expected = interpolate.CubicSpline(points, values)
    beyond = np.linspace(points[0] - 0.5, points[-1] + 0.5, 50)
    assert_allclose(saltus.spline(beyond, points, values), expected(beyond), rtol=1e-12, atol=1e-13)
    assert_allclose(saltus.interp(beyond, points, values), np.interp(beyond, points, values), rtol=1e-15)
    names = [f"p{i}" for i in range(count)]
    system = one_mode(lambda t, x, p: [saltus.spline(t, points, p), 1 / saltus.spline(x[1], points, values)], ["x", "y"], names)
    end = points[-1] + 0.2
    motion, d = derivatives(system, [0.0, 0.0], values, end)
    assert_allclose(motion.final[0], expected.integrate(0, end), rtol=1e-12)
    assert_allclose(expected.integrate(0, motion.final[1]), end, rtol=1e-11)
    cardinal = [interpolate.CubicSpline(points, row).integrate(0, end) for row in np.eye(count)]
    assert_allclose(d.by_parameters, [cardinal, [0] * count], rtol=1e-10, atol=1e-12)
    assert_allclose(d.by_initial[1, 1], expected(0) / expected(motion.final[1]), rtol=1e-10)
    assert len([number for *_, number in motion.switches if number.startswith("t")]) == count


def test_tables_in_costs_and_guards():
    """A ball falls onto ground whose height is a table of its position; its cost is one too."""
    ground = ([0.0, 1.0, 3.0], [0.0, 0.2, 0.0])
    ball = saltus.HybridSystem(
        states={"m": ["x", "y", "v"]}, flow={"m": lambda x: [1.5, x[2], -9.8]},
        guards={"m": {"ground": lambda x: x[1] - saltus.interp(x[0], *ground)}},
        resets={"m": {"ground": lambda x: ("m", [x[0], x[1], -x[2]])}})
    problem = saltus.HybridProblem(ball, mode="m", initial=[0.0, 1.4, 0.0], duration=0.7,
                                   costs=[saltus.cost(lambda x: saltus.spline(x[0], [0, 1, 2, 3], [0, 1, 8, 27]))])
    times = [event[0] for event in saltus.rollout(problem).events]
    root = (-0.3 + math.sqrt(0.3**2 + 4 * 4.9 * 1.4)) / (2 * 4.9)  # 1.4 - 4.9 t^2 = 0.2 (1.5 t)
    assert 1.5 * root < 1
    assert_allclose(times, [root], rtol=1e-12)
    found = saltus.loss_and_gradient(problem)
    assert_allclose([found.loss, found.gradient.initial[0]], [1.05**3, 3 * 1.05**2], rtol=1e-12)


@pytest.mark.parametrize("function", [saltus.interp, saltus.spline])
@pytest.mark.parametrize("table, words", [
    (([0, 0], [1, 2]), "expected xs with increasing numbers, and as many values ys"),
    (([0, 1], [1]), "expected xs with increasing numbers, and as many values ys"),
    (([0, np.nan], [1, 2]), "found xs with a number that is not finite"),
    (([0, 1], [1, np.inf]), "found ys with a number that is not finite"),
])
def test_wrong_tables_are_refused_in_recorded_functions_and_outside(function, table, words):
    name = f"{function.__name__}: "
    with pytest.raises(ValueError, match=name + words):
        function(0.5, *table)
    with pytest.raises(ValueError, match="flow of mode 'm': " + name + words):
        one_mode(lambda t, x, u, p: [function(x[0], *table)])
    with pytest.raises(ValueError, match="spline: found one point in xs, expected at least two"):
        saltus.spline(0, [0], [1])


def test_a_comparator_most_of_whose_events_hide_from_few_steps_is_followed():
    # A few thousand uniform steps see a third of the events, and seem to miss changes at a few places only.
    frequency, duty = 2977, 0.31388
    w, a, y, before, on = 2 * math.pi * frequency, math.asin(duty), 0.0, 0.0, 1
    times = [(phase + 2 * math.pi * k) / w for k in range(frequency) for phase in (a, math.pi - a)]
    for time in [*times, 1.0]:
        y, before, on = on + (y - on) * math.exp(before - time), time, 1 - on
    comparator = saltus.HybridSystem(
        states={"on": ["y"], "off": ["y"]}, parameters=["d"], flow={"on": lambda x: [1 - x[0]], "off": lambda x: [-x[0]]},
        guards={"on": {"off": lambda t, p: p[0] - np.sin(w * t)}, "off": {"on": lambda t, p: np.sin(w * t) - p[0]}},
        resets={"on": {"off": lambda x: ("off", x)}, "off": {"on": lambda x: ("on", x)}})
    found = saltus.rollout(saltus.HybridProblem(comparator, mode="on", initial=[0], parameters=[duty], duration=1.0))
    assert len(found.events) == len(times)
    assert_allclose(found.final[0], y, atol=1e-11)


@pytest.mark.parametrize("spin, speed", [((40.0, -60.0), 2e-6), ((40.0, -60.0), 1e-4), ((40.0, -60.0), 1e-2),
                                         ((-20.0, 90.0), 2e-6), ((-20.0, 90.0), 1e-4), ((-20.0, 90.0), 1e-2)])
def test_a_ball_on_cloth_grips_where_its_slip_ends(speed, spin):
    """The friction has the direction of the slip, which turns round within any step behind the guard: below this speed the ball
    rolls. Slip and spin have a closed form, as the direction does not change."""
    radius, gravity, mu = 0.028575, 9.81, 0.2

    def slide(x, p):
        slip = np.array([x[2] - radius * x[5], x[3] + radius * x[4]])
        ax, ay = [-p[0] * gravity * s / np.hypot(slip[0], slip[1]) for s in slip]
        return [x[2], x[3], ax, ay, 2.5 / radius * ay, -2.5 / radius * ax]

    def roll(x, p):
        ax, ay = [-p[1] * gravity * v / np.hypot(x[2], x[3]) for v in (x[2], x[3])]
        return [x[2], x[3], ax, ay, -ay / radius, ax / radius]

    names = ["x", "y", "vx", "vy", "wx", "wy"]
    ball = saltus.HybridSystem(
        states={"slide": names, "roll": names}, parameters=["mu_slide", "mu_roll"], flow={"slide": slide, "roll": roll},
        guards={"slide": {"grip": lambda x: (x[2] - radius * x[5])**2 + (x[3] + radius * x[4])**2 - (speed / 2)**2}},
        resets={"slide": {"grip": lambda x: ("roll", [x[0], x[1], x[2], x[3], -x[3] / radius, x[2] / radius])}})
    start = np.array([0, 0, 3, 0, *spin])
    motion = saltus.rollout(saltus.HybridProblem(ball, mode="slide", initial=start, parameters=[mu, 0.01], duration=2.0))
    slip = np.array([start[2] - radius * start[5], start[3] + radius * start[4]])
    direction = slip / np.linalg.norm(slip)
    grip = (np.linalg.norm(slip) - speed / 2) / (3.5 * mu * gravity)
    assert [event[1:] for event in motion.events] == [("slide", "grip", "roll")]
    assert motion.events[0][0] == pytest.approx(grip, rel=1e-9)
    v = start[2:4] - mu * gravity * grip * direction
    after = 2.0 - grip
    along = v / np.linalg.norm(v)
    assert_allclose(motion.final[2:4], v - 0.01 * gravity * after * along, rtol=1e-8, atol=1e-9)
    expected = start[2:4] * grip - 0.5 * mu * gravity * grip**2 * direction + v * after - 0.005 * gravity * after**2 * along
    assert_allclose(motion.final[:2], expected, rtol=1e-8, atol=1e-9)
