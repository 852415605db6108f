"""What functions of users are given and refused for: arguments by name, errors of numpy, costs and options that are none."""

import math

import numpy as np
import pytest
from conftest import problem_of
from numpy.testing import assert_allclose

import saltus


def final_of(**functions):
    system = saltus.HybridSystem(states={"m": ["y", "v"]}, controls=["f"], parameters=["g"], **{
        "flow": {"m": lambda t, x, u, p: [x[1], u[0] + 5 - p[0]]}, **functions})
    return saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[1, 0], parameters=[9.81], control=[[0.5]], duration=1.0)).final


def test_flows_get_what_their_arguments_are_named():
    right = [1 + (5.5 - 9.81) / 2, 5.5 - 9.81]
    for flow in (lambda t, x, u, p: [x[1], u[0] + 5 - p[0]], lambda t, x, p, u: [x[1], u[0] + 5 - p[0]],
                 lambda p, u, x: [x[1], u[0] + 5 - p[0]], lambda x, *, u, p: [x[1], u[0] + 5 - p[0]],
                 lambda time, state, force, par: [state[1], force[0] + 5 - par[0]],
                 lambda t, state, u, p: [state[1], u[0] + 5 - p[0]],
                 lambda t, x, u, p, k=5: [x[1], u[0] + k - p[0]]):
        assert_allclose(final_of(flow={"m": flow}), right, rtol=1e-13)
    for guard in (lambda x: x[0] - 0.5, lambda p, x: x[0] - 0.5 + 0 * p[0], lambda a, b, c: b[0] - 0.5):
        for reset in (lambda x: ("m", [1, 0 * x[0]]), lambda p, t, x: ("m", [1 + 0 * x[0], 0 * p[0]]), lambda a, b, c: ("m", [1, 0 * b[0]])):
            # It falls by 0.5 in s = sqrt(1 / 4.31), and begins again at rest, twice.
            s = math.sqrt(1 / 4.31)
            assert_allclose(final_of(guards={"m": {"g": guard}}, resets={"m": {"g": reset}})[1], -4.31 * (1 - 2 * s), rtol=1e-12)
    assert_allclose(final_of(fly={"m": lambda x, u, p, s: [x[0] + s * x[1] + s * s / 2 * (u[0] + 5 - p[0]), x[1] + s * (u[0] + 5 - p[0])]}),
                    right, rtol=1e-13)


@pytest.mark.parametrize("changes, message", [
    ({"flow": {"m": lambda t, state, p, u: [0, 0]}}, "flow of mode 'm': found an argument 'state', expected some of t, x, u and p"),
    ({"flow": {"m": lambda t, x, u, q: [0, 0]}}, None),  # in the usual order
    ({"flow": {"m": lambda t, x, h: [0, 0]}}, "flow of mode 'm': found an argument 'h'"),
    ({"guards": {"m": {"g": lambda t, x, u, p: 1 - u[0]}}, "resets": {"m": {"g": lambda x, u: ("m", x)}}},
     "reset 'g' of mode 'm': found an argument 'u': resets read t, x and p; make the control a state"),
    ({"guards": {"m": {"g": lambda y: 1}}, "resets": {"m": {"g": lambda x: ("m", x)}}}, "guard 'g' of mode 'm': found an argument 'y'"),
    ({"flow": {"m": lambda t, x, u, p: None}}, "flow of mode 'm': found nothing that the function returns"),
])
def test_arguments_with_other_names(changes, message):
    if message is None:
        final_of(**changes)
        return
    with pytest.raises(ValueError, match=message):
        final_of(**changes)


def test_steps_of_an_audit_get_what_their_arguments_are_named():
    """The explicit Euler method; its gradient is consistent whatever the order and the defaults of the arguments."""
    problem = problem_of(flow=lambda t, x, u, p: [x[1], u[0] - x[0] + t], costs=[saltus.terminal([1, 0])])

    def euler(x, u, t, h):
        return "m", [x[0] + h * x[1], x[1] + h * (u[0] - x[0] + t)]

    verdicts = [saltus.audit(problem, step=step, steps=16) for step in (
        lambda mode, t, x, u, p, h: euler(x, u, t, h), lambda mode, x, t, h, u: euler(x, u, t, h),
        lambda mode, t, x, u, p, h, k=2: euler(x, u, t, h), lambda m, time, state, force, par, step: euler(state, force, time, step))]
    assert {found.verdict for found in verdicts} == {"consistent"}
    assert len({found.parts[0]["levels"][0]["error"] for found in verdicts}) == 1
    without_time = saltus.audit(problem, step=lambda mode, x, u, p, h, k=2: euler(x, u, 0, h), steps=16)
    assert without_time.verdict == "wrong" or without_time.parts[0]["levels"][0]["error"] != verdicts[0].parts[0]["levels"][0]["error"]
    with pytest.raises(ValueError, match="step: found an argument 'dt', expected some of mode, x, u, p, h and t"):
        saltus.audit(problem, step=lambda mode, x, dt: euler(x, [0], 0, dt), steps=16)
    for result in (np.zeros(2), None, ("m", [0, 0], 1), (0, [0, 0])):
        with pytest.raises(ValueError, match="step: found .*, expected the next mode's name and its state"):
            saltus.audit(problem, step=lambda mode, x, h, found=result: found, steps=16)


def test_errors_of_numpy_keep_their_text_and_get_the_place():
    for flow, text in ((lambda x: np.linalg.svd(np.array([[x[0], 1], [0, 1]])), "flow of mode 'm': .*"),
                       (lambda x: np.array([x[0], 1]) @ np.ones((3, 3)), "flow of mode 'm': matmul"),
                       (lambda x: np.linalg.eigvals([[x[0]]]), "flow of mode 'm': .*")):
        with pytest.raises((TypeError, ValueError, RuntimeError), match=text) as caught:
            saltus.HybridSystem(states={"m": ["y", "v"]}, flow={"m": flow})
        assert "__init__" not in str(caught.value)


def test_a_cost_at_an_event_reads_the_state_after_it():
    """The sizes of the states before and behind an event differ."""
    system = saltus.HybridSystem(
        states={"one": ["y"], "two": ["a", "b"]}, flow={"one": lambda t: [-1], "two": lambda t: [0, 1]},
        guards={"one": {"g": lambda x: x[0]}}, resets={"one": {"g": lambda x, t: ("two", [t, 3])}})
    problem = saltus.HybridProblem(system, mode="one", initial=[0.5], duration=1.0)
    problem.costs = [saltus.residuals(lambda x: [x[0] + 10 * x[1]], at="event", mode="one", guard="g")]
    assert_allclose(saltus.loss_and_gradient(problem).loss, 30.5**2, rtol=1e-12)
    problem.costs = [saltus.residuals(lambda x, t: [x[0] - t], at="event", mode="one", guard="g", before=True)]
    assert_allclose(saltus.loss_and_gradient(problem).loss, 0.25, rtol=1e-12)


@pytest.mark.parametrize("make", [
    lambda: saltus.terminal([1, 0], weight=-1), lambda: saltus.terminal([1, 0], weight=math.nan),
    lambda: saltus.terminal([1, 0], weight=math.inf), lambda: saltus.terminal([math.inf, 0]), lambda: saltus.terminal([None, None]),
    lambda: saltus.effort(-1), lambda: saltus.effort(math.nan), lambda: saltus.effort(math.inf),
    lambda: saltus.final_time(-1), lambda: saltus.final_time(math.inf), lambda: saltus.residuals(lambda x: x, at="often"),
])
def test_costs_that_are_none(make):
    with pytest.raises(ValueError):
        make()


@pytest.mark.parametrize("options", [
    {"iterations": -1}, {"optimize": []}, {"optimize": ["c", "c"]}, {"optimize": ["initial", "y"]}, {"optimize": ["sky"]},
    {"optimize": [""]}, {"bounds": {"f": (1, -1)}}, {"bounds": {"f": (math.nan, 1)}}, {"bounds": {"sky": (0, 1)}},
    {"solver": ""}, {"solver": "sky"},
])
def test_options_of_solvers_that_are_none(options):
    with pytest.raises(ValueError):
        saltus.solve(problem_of(), **{"solver": "ceres_phases", **options})


def _line(**changes):
    system = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], parameters=["c"],
                                 flow={"m": lambda x, u, p: [x[1], u[0] - p[0] * x[1]]})
    given = {"initial": [0, 0], "parameters": [0.5], "duration": 1.0, "control": np.zeros((4, 1)), **changes}
    return saltus.HybridProblem(system, mode="m", costs=[saltus.terminal([1, 0], weight=10), saltus.effort(0.1)], **given)


@pytest.mark.parametrize("call, name", [
    (lambda p: saltus.rollout(p, control=np.ones((4, 1))), "control"),
    (lambda p: saltus.rollout(p, "lcp"), "contact"),
    (lambda p: saltus.rollout(p, velocity=[1]), "velocity"),
    (lambda p: saltus.loss_and_gradient(p, control=np.ones((4, 1))), "control"),
    (lambda p: saltus.solve(p, "gd"), "contact"),
    (lambda p: saltus.solve(p, surrogate="smoothed_zeroth"), "surrogate"),
    (lambda p: saltus.solve(p, memory_limit=-1), "memory_limit"),
    (lambda p: saltus.solve(p, keep_iterates=True), "keep_iterates"),
    (lambda p: saltus.noisy_runs(p, np.eye(2), contact="lcp"), "contact"),
    (lambda p: saltus.audit(p, "lcp", step=lambda x, u, p, h: x), "contact"),
])
def test_what_a_hybrid_problem_does_not_take_is_refused(call, name):
    with pytest.raises(ValueError, match=f"^{name}: found .*, expected none, as a HybridProblem does not take it"):
        call(_line())


@pytest.mark.parametrize("changes", [{"initial": [0.5, 0]}, {"duration": 2.0}, {"parameters": [2.0]}])
@pytest.mark.parametrize("solver", ["auto", "ceres_lm"])
def test_a_run_to_start_from_changes_nothing_that_is_fixed(changes, solver):
    run = saltus.solve(_line())
    cold, warm = saltus.solve(_line(**changes), solver=solver), saltus.solve(_line(**changes), solver=solver, start=run)
    np.testing.assert_allclose(warm.loss, cold.loss, rtol=1e-8)
    assert np.array_equal(warm.initial, cold.initial) and np.array_equal(warm.parameters, cold.parameters)
    assert abs(np.sum(warm.durations) - np.sum(cold.durations)) < 1e-12
    free = saltus.solve(_line(**changes), solver="ceres_lm", optimize=["control", "x", "c"], start=run, iterations=0)
    assert free.initial[0] == run.initial[0] and free.parameters[0] == run.parameters[0]
