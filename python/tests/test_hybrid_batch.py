"""Hybrid problems at many points, and as functions of other packages."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import saltus


def ball_problem(**changes):
    """A ball that bounces on the ground at y = 0 and is pushed; parameters g and e."""
    ball = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["f"], parameters=["g", "e"],
        flow={"flight": lambda x, u, p: [x[1], u[0] - p[0] - 0.01 * x[1] * x[1] * x[1]]},
        guards={"flight": {"ground": lambda x: x[0]}},
        resets={"flight": {"ground": lambda x, p: ("flight", [x[0], -p[1] * x[1]])}})
    given = {"mode": "flight", "initial": [1.0, 0.0], "parameters": [9.81, 0.8], "duration": 1.3,
             "control": np.linspace(-1, 1, 5)[:, None], "costs": [saltus.terminal([0.5, None]), saltus.effort(0.1)]}
    return saltus.HybridProblem(ball, **{**given, **changes})


def slider(**changes):
    """A mass that bounces, slides and sticks, whose first mode depends on the point."""
    system = saltus.MechanicalSystem(
        coordinates=["x", "y"], controls=["f"], parameters=["e", "mu"], mass=lambda q: np.eye(2),
        force=lambda u: [u[0], -9.81],
        contacts={"ground": saltus.Contact(gap=lambda q: q[1], slide=lambda q: q[0], restitution="e", friction="mu")})
    given = {"initial": [0, 0.1, 2, 0], "parameters": [0.3, 0.2], "duration": 0.7, "control": np.zeros((3, 1)),
             "costs": [saltus.terminal([1.0, None, None, None])]}
    return saltus.HybridProblem(system, **{**given, **changes})


def points_of(problem, count, seed=3):
    random = np.random.default_rng(seed)
    center = np.concatenate([np.ravel(problem.control), problem.initial, problem.parameters, [problem.duration]])
    return center * (1 + 0.1 * random.uniform(-1, 1, (count, len(center))))


def one_by_one(problem, points):
    """Losses and gradients of problems that are made for each point."""
    K, m = np.shape(problem.control)
    n, P = len(problem.initial), len(problem.parameters)
    losses, gradients = [], []
    for point in points:
        changes = {"control": point[: K * m].reshape(K, m), "initial": point[K * m : K * m + n],
                   "parameters": point[K * m + n : K * m + n + P], "duration": point[-1]}
        found = saltus.loss_and_gradient(type(problem)(problem.system, mode=problem.mode, costs=problem.costs, **changes))
        losses.append(found.loss)
        gradients.append(np.concatenate([found.gradient["control"].ravel(), found.gradient["initial"],
                                         found.gradient["parameters"], [found.gradient["duration"]]]))
    return np.array(losses), np.array(gradients)


ALL = ["control", "initial", "parameters", "duration"]


@pytest.mark.parametrize("make", [ball_problem, slider])
def test_a_batch_has_the_bits_of_each_problem_by_itself(make):
    problem = make()
    points = points_of(problem, 12)
    if make is slider:
        points[::3, 4] = 0.0  # y: it lies on the ground, and slides from the start
        points[::3, 6] = 0.0
    expected = one_by_one(problem, points)
    for threads in (1, 2):
        batch = saltus.HybridBatch(problem, optimize=ALL, threads=threads)
        losses, gradients = batch.loss_and_gradient(points)
        assert_array_equal(losses, expected[0])
        assert_array_equal(gradients, expected[1])
        assert_array_equal(batch.loss(points), losses)
        assert batch.failures == {}


def test_points_have_names_and_may_have_the_shape_of_the_control():
    problem = ball_problem()
    batch = saltus.HybridBatch(problem)
    assert batch.variables == [f"f[{k}]" for k in range(5)]
    controls = np.array([problem.control, 2 * np.asarray(problem.control)])
    losses, gradients = batch.loss_and_gradient(controls)
    assert gradients.shape == (2, 5, 1)
    problem.control = controls[1]
    found = saltus.loss_and_gradient(problem)
    assert losses[1] == found.loss
    assert_array_equal(gradients[1], found.gradient["control"])
    assert saltus.HybridBatch(problem, optimize=["v", "e", "duration"]).variables == ["v", "e", "duration"]


def test_points_without_a_motion_are_not_numbers_and_have_a_reason():
    batch = saltus.HybridBatch(slider(), optimize=["y", "e"])
    losses, gradients = batch.loss_and_gradient([[0.1, 0.3], [-0.1, 0.3], [0.1, 2.0], [np.inf, 0.3]][:3])
    assert np.isfinite(losses[0]) and np.isnan(losses[1:]).all() and np.isnan(gradients[1:]).all()
    assert list(batch.failures) == [1, 2]
    assert "penetrates, its gap is -0.1" in batch.failures[1]
    assert "found a restitution of 2" in batch.failures[2]
    with pytest.raises(ValueError, match="points: expected an array of P points of 2 numbers"):
        batch.loss([[1.0, 2.0, 3.0]])
    with pytest.raises(ValueError, match=r"points\[0, 1\]: found nan"):
        batch.loss([[0.1, np.nan]])
    with pytest.raises(TypeError, match="problem: found str, expected a saltus.HybridProblem"):
        saltus.HybridBatch("ball")


class TestEndState:
    @pytest.mark.parametrize("make", [ball_problem, slider])
    def test_vjp_is_the_transposed_jacobian(self, make):
        """Against forward sweeps."""
        problem = make()
        end, by = saltus.HybridEndState(problem), saltus.final_derivatives(problem)
        assert_array_equal(end(end.initial, end.control, end.parameters), saltus.rollout(problem).final)
        for row, cotangent in enumerate(np.eye(len(end.initial))):
            found = end.vjp(end.initial, end.control, end.parameters, cotangent)
            for part, expected in zip(found, (by.by_initial, by.by_control, by.by_parameters)):
                assert_allclose(part, expected[row], rtol=1e-10, atol=1e-11)

    def test_torch(self):
        torch = pytest.importorskip("torch", reason="python3-torch is not installed")
        import saltus.torch

        for problem in (ball_problem(), slider()):
            end = saltus.HybridEndState(problem)
            given = [torch.from_numpy(part).requires_grad_() for part in (end.initial, end.control, end.parameters)]
            assert torch.autograd.gradcheck(saltus.torch.end_state(problem), given, eps=1e-6, atol=1e-5, rtol=1e-5)
            batch = saltus.HybridBatch(problem)
            points = torch.from_numpy(np.array([problem.control, problem.control]) + 0.1).requires_grad_()
            assert torch.autograd.gradcheck(saltus.torch.losses(batch), (points,), eps=1e-6, atol=1e-6)

    def test_jax(self):
        jax = pytest.importorskip("jax", reason="jax is not installed")
        jax.config.update("jax_enable_x64", True)
        import saltus.jax

        for problem in (ball_problem(), slider()):
            end, by = saltus.jax.end_state(problem), saltus.final_derivatives(problem)
            given = [jax.numpy.asarray(part, dtype=float) for part in (problem.initial, problem.control, problem.parameters)]
            jacobians = jax.jit(jax.jacrev(end, argnums=(0, 1, 2)))(*given)
            for part, expected in zip(jacobians, (by.by_initial, by.by_control, by.by_parameters)):
                assert_allclose(part, expected, rtol=1e-10, atol=1e-11)
            batch = saltus.HybridBatch(problem)
            points = np.array([problem.control, problem.control]) + 0.1
            losses, gradients = batch.loss_and_gradient(points)
            function = saltus.jax.losses(batch)
            assert_array_equal(jax.jit(function)(points), losses)
            found = jax.jit(jax.grad(lambda points: function(points) @ np.array([1.0, 2.0])))(points)
            assert_allclose(found, gradients * np.array([1.0, 2.0])[:, None, None], rtol=1e-15)
