"""Functions of hybrid systems that solve linear equations, and guards that read the control."""

import numpy as np
import pytest
from numpy.linalg import inv
from numpy.testing import assert_allclose

import saltus


def one_mode(flow, states, parameters=(), **rest):
    return saltus.HybridSystem(states={"m": list(states)}, parameters=list(parameters), flow={"m": flow}, **rest)


def derivative_of(flow, x, p=()):
    """The flow's value and derivatives, from a step that is too short for anything else."""
    h = 1e-7
    system = one_mode(flow, [f"x{i}" for i in range(len(x))], [f"p{i}" for i in range(len(p))])
    problem = saltus.HybridProblem(system, mode="m", initial=x, parameters=p, duration=h)
    d = saltus.final_derivatives(problem)
    return d.by_duration, (d.by_initial - np.eye(len(x))) / h, d.by_parameters / h


def mass(q, m):
    """Of a double pendulum."""
    c = np.cos(q[0] - q[1])
    return np.array([[1 + m, m * c], [m * c, m]])


def test_a_mass_matrix():
    """M(q) a = f against the inverse of 2 x 2 matrices as a formula: values and derivatives of a whole motion."""
    def force(x, m):
        s = np.sin(x[0] - x[1])
        return [-m * s * x[3] ** 2 - (1 + m) * 9.81 * np.sin(x[0]), m * s * x[2] ** 2 - m * 9.81 * np.sin(x[1])]

    def by_solve(t, x, u, p):
        return [x[2], x[3], *np.linalg.solve(mass(x, p[0]), force(x, p[0]))]

    def by_inverse(t, x, u, p):
        return [x[2], x[3], *(np.linalg.inv(mass(x, p[0])) @ force(x, p[0]))]

    def by_imported_inverse(t, x, u, p):
        return [x[2], x[3], *(inv(mass(x, p[0])) @ force(x, p[0]))]

    def by_hand(t, x, u, p):
        (a, b), (_, d), (f, g) = *mass(x, p[0]), force(x, p[0])
        det = a * d - b * b
        return [x[2], x[3], (d * f - b * g) / det, (a * g - b * f) / det]

    def found(flow):
        system = one_mode(flow, ["a", "b", "v", "w"], ["m"])
        problem = saltus.HybridProblem(system, mode="m", initial=[0.6, -0.3, 0.2, 0.5], parameters=[0.7], duration=2.0)
        motion, d = saltus.rollout(problem), saltus.final_derivatives(problem)
        assert motion.remark == d.remark == ""
        return np.hstack([motion.final[:, None], d.by_initial, d.by_parameters])

    right = found(by_hand)
    for flow in (by_solve, by_inverse, by_imported_inverse):
        assert_allclose(found(flow), right, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 12])
def test_matrices_that_need_pivots(n):
    """Random matrices, some of whose pivots are zero where they are evaluated; derivatives by d(A^-1 b) = A^-1 (db - dA x)."""
    rng = np.random.default_rng(n)
    for _ in range(3):
        A0, A1 = rng.normal(size=(n, n)), rng.normal(size=(n, n))
        A0[0, 0] = -0.3 * A1[0, 0] if n > 1 else A0[0, 0]  # the first pivot is zero at p = 0.3
        if n > 2:
            A0[1, :2] = A0[2, :2]
            A1[1, :2] = A1[2, :2]
        b0, b1 = rng.normal(size=n), rng.normal(size=n)
        slope, _, by_p = derivative_of(lambda t, x, u, p: np.linalg.solve(A0 + p[0] * A1, b0 + p[0] * b1), np.zeros(n), [0.3])
        A, b = A0 + 0.3 * A1, b0 + 0.3 * b1
        x = np.linalg.solve(A, b)
        size = np.linalg.cond(A) * np.max(np.abs(x))
        assert_allclose(slope, x, atol=1e-13 * size)
        assert_allclose(by_p[:, 0], np.linalg.solve(A, b1 - A1 @ x), atol=1e-12 * size * np.linalg.cond(A))


def test_constraints_and_matrices_on_the_right():
    """A saddle-point system whose last pivot is structurally zero, and several right-hand sides."""
    def flow(t, x, u, p):
        K = np.array([[2.0, 0.0, x[0]], [0.0, p[0], x[1]], [x[0], x[1], 0.0]])
        return np.linalg.solve(K, [[1.0, 0.0], [x[1], 1.0], [0.0, 2.0]]).sum(axis=1)

    x, p = np.array([0.4, -0.8, 0.1]), 1.5
    exact = lambda x, p: np.linalg.solve(np.array([[2, 0, x[0]], [0, p, x[1]], [x[0], x[1], 0]]), [[1, 0], [x[1], 1], [0, 2]]).sum(axis=1)
    slope, by_x, by_p = derivative_of(flow, x, [p])
    assert_allclose(slope, exact(x, p), rtol=1e-6)
    for i in range(2):
        step = 1e-6 * np.eye(3)[i]
        assert_allclose(by_x[:, i], (exact(x + step, p) - exact(x - step, p)) / 2e-6, rtol=1e-5, atol=1e-5)
    assert_allclose(by_p[:, 0], (exact(x, p + 1e-6) - exact(x, p - 1e-6)) / 2e-6, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("matrix", [
    lambda x: [[x[0], 2 * x[0]], [2 * x[0], 4 * x[0]]], lambda x: [[0.1 * x[0], 0.3 * x[0]], [0.2 * x[0], 0.6 * x[0]]],
    lambda x: [[x[1] - x[1], 1.0], [0.0, 1.0]],
])
def test_a_singular_matrix_is_refused(matrix):
    system = one_mode(lambda t, x, u, p: np.linalg.solve(np.array(matrix(x)), [1.0, 1.0]), ["a", "b"])
    with pytest.raises(RuntimeError, match="the flow of mode 'm' at t = 0 gives no finite derivative of"):
        saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.7, 0.2], duration=1.0))


@pytest.mark.parametrize("flow, text", [
    (lambda t, x, u, p: np.linalg.solve(np.array([[0, 0], [0, 1 + x[0]]]), x), "singular, whatever the arguments"),
    (lambda t, x, u, p: np.linalg.solve(np.array([[1, x[0], 0], [0, 1, 0]]), x), r"found a matrix of shape \(2, 3\)"),
    (lambda t, x, u, p: np.linalg.solve(x[0] * np.eye(13), np.ones(13))[:2], "found 13 unknowns, expected at most 12"),
    (lambda t, x, u, p: np.linalg.norm(x, 1) * x, "norm is recorded without further arguments"),
])
def test_what_cannot_be_solved(flow, text):
    with pytest.raises((TypeError, ValueError), match="flow of mode 'm': .*" + text):
        one_mode(flow, ["a", "b"])


def test_a_norm():
    slope, by_x, _ = derivative_of(lambda t, x, u, p: [np.linalg.norm(x), np.linalg.norm([3.0, 4.0])], [0.6, 0.8])
    assert_allclose(slope, [1, 5], rtol=1e-6)
    assert_allclose(by_x, [[0.6, 0.8], [0, 0]], atol=1e-5)


# A mass on a floor that lifts off when the force exceeds its weight: y'' = u - g.
def hopper(**rest):
    return saltus.HybridSystem(
        states={"rest": ["y", "v"], "air": ["y", "v"]}, controls=["u"], parameters=["g"],
        flow={"rest": lambda t, x, u, p: [0, 0], "air": lambda t, x, u, p: [x[1], u[0] - p[0]]},
        guards={"rest": {"lift": lambda t, x, u, p: p[0] + 0.5 * t - u[0]}, "air": {"land": lambda t, x, p: x[0] + 1}},
        resets={"rest": {"lift": lambda t, x, p: ("air", x)}, "air": {"land": lambda t, x, p: ("rest", [0, 0])}}, **rest)


def test_a_jump_of_the_control_takes_a_guard_below_zero():
    problem = saltus.HybridProblem(hopper(), mode="rest", initial=[0, 0], parameters=[9.0], duration=3.0, control=[[5.0], [12.0], [8.0]])
    motion, d = saltus.rollout(problem), saltus.final_derivatives(problem)
    assert [(event[0], event[2]) for event in motion.events] == [(1.0, "lift")]
    assert motion.remark == d.remark == ""
    assert_allclose(motion.final, [1.5 + 3 - 0.5, 3 - 1], rtol=1e-12)
    assert_allclose(d.by_control.reshape(2, -1), [[0, 1.5, 0.5], [0, 1, 1]], atol=1e-12)
    assert_allclose(d.by_parameters.ravel(), [-2, -2], rtol=1e-12)
    # y(T) with T = 3 h: 3 h^2 / 2 + 3 h^2 - h^2 / 2 = 4 h^2
    assert_allclose(d.by_duration, [8 / 3, 2 / 3], rtol=1e-12)
    assert_allclose(d.times_by_duration.ravel(), [1 / 3], rtol=1e-12)


def test_the_time_of_an_event_depends_on_the_control():
    """A guard u - 1 - t falls through zero at t = u - 1; from there x' = 1."""
    clock = saltus.HybridSystem(
        states={"off": ["x"], "on": ["x"]}, controls=["u"],
        flow={"off": lambda t, x, u, p: [0], "on": lambda t, x, u, p: [u[0]]},
        guards={"off": {"start": lambda t, x, u: u[0] - 1 - t}}, resets={"off": {"start": lambda t, x, p: ("on", x)}})
    problem = saltus.HybridProblem(clock, mode="off", initial=[0], duration=2.0, control=[[1.4], [3.0]])
    d = saltus.final_derivatives(problem)
    assert_allclose(saltus.rollout(problem).final, [1.4 * 0.6 + 3.0], rtol=1e-12)
    assert_allclose(d.by_control.ravel(), [0.6 - 1.4, 1.0], rtol=1e-12)
    assert_allclose(d.times_by_control.ravel(), [1, 0], atol=1e-12)
    assert d.remark == ""


def test_a_solver_lifts_the_mass():
    problem = saltus.HybridProblem(hopper(), mode="rest", initial=[0, 0], parameters=[9.0], duration=3.0, control=[[5.0], [12.0], [8.0]],
                                   costs=[saltus.terminal([3.0, 0.5]), saltus.effort(1e-4)])
    g = saltus.loss_and_gradient(problem)
    for k in range(3):
        losses = []
        for step in (1e-5, -1e-5):
            moved = np.array(problem.control, dtype=float)
            moved[k] += step
            losses.append(saltus.loss_and_gradient(saltus.HybridProblem(
                hopper(), mode="rest", initial=[0, 0], parameters=[9.0], duration=3.0, control=moved, costs=problem.costs)).loss)
        assert_allclose(g.gradient.control[k, 0], (losses[0] - losses[1]) / 2e-5, atol=1e-7)
    run = saltus.solve(problem, solver="ceres_lm", optimize=["control"])
    assert run.loss < g.loss


def test_resets_have_no_control():
    with pytest.raises(ValueError, match="reset 'g' of mode 'm': found an argument 'u'"):
        one_mode(lambda t, x, u, p: [0], ["x"], controls=["u"], guards={"m": {"g": lambda x, u: x[0] - u[0]}},
                 resets={"m": {"g": lambda t, x, u, p: ("m", x)}})
