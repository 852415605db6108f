"""Other packages' optimizers and automatic differentiation, on our gradients."""

import numpy as np
import pytest

import saltus


@pytest.fixture
def short(two_balls):
    """Few variables, and an impact well inside a step."""
    return two_balls.replace(steps=12)


class TestEndState:
    def test_is_that_of_the_rollout(self, short):
        end = saltus.EndState(short, "toi_velocity")
        motion = saltus.rollout(short, "toi_velocity")
        np.testing.assert_array_equal(end(end.initial, end.control), motion.final_state)

    def test_vjp_is_the_transposed_jacobian(self, short):
        """Against the steps' own linearizations, multiplied out."""
        end = saltus.EndState(short, "direct_toi")
        A, B = saltus.linearize(short, "direct_toi")
        by_initial, by_control = np.eye(8), []
        for k in reversed(range(12)):
            by_control.insert(0, by_initial @ B[k].reshape(8, 2))
            by_initial = by_initial @ A[k]
        for row in range(8):
            cotangent = np.eye(8)[row].reshape(2, 4)
            found = end.vjp(end.initial, end.control, cotangent)
            np.testing.assert_allclose(found[0].ravel(), by_initial[row], rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(found[1].reshape(12, 2), [by[row] for by in by_control], rtol=1e-10, atol=1e-12)

    def test_is_the_same_in_any_order(self, short):
        """The derivative after its motion, after another one and afresh."""
        fresh, end = saltus.EndState(short, "event"), saltus.EndState(short, "event")
        cotangent = np.ones((2, 4))
        expected = fresh.vjp(fresh.initial, fresh.control, cotangent)
        for before in (end.control, end.control + 0.1):
            end(end.initial, before)
            for found, there in zip(end.vjp(end.initial, end.control, cotangent), expected):
                np.testing.assert_array_equal(found, there)

    def test_refusals(self, short):
        end = saltus.EndState(short)
        with pytest.raises(ValueError, match=r"initial: found shape \(2, 2\), expected \(2, 4\)"):
            end(np.zeros((2, 2)), end.control)
        with pytest.raises(ValueError, match=r"cotangent\[0, 3\]: found nan"):
            end.vjp(end.initial, end.control, [[0, 0, 0, np.nan], [0, 0, 0, 0]])


class TestTorch:
    @pytest.fixture(autouse=True)
    def torch(self):
        return pytest.importorskip("torch", reason="python3-torch is not installed")

    @pytest.mark.parametrize("contact", ["event", "toi_velocity", "smooth_compliant"])
    def test_gradcheck(self, torch, short, contact):
        import saltus.torch

        end = saltus.torch.EndState(short, contact)
        arguments = end.initial.requires_grad_(), end.control.requires_grad_()
        assert torch.autograd.gradcheck(end, arguments, eps=1e-6, atol=1e-5, rtol=1e-5)
        simulation = saltus.Simulation(short, contact)
        z = torch.from_numpy(simulation.initial_guess).requires_grad_()
        assert torch.autograd.gradcheck(lambda z: saltus.torch.loss(simulation, z), (z,), eps=1e-6, atol=1e-6)

    def test_a_loss_written_in_torch(self, torch, short):
        import saltus.torch

        end = saltus.torch.EndState(short, "event")
        control = end.control.requires_grad_()
        loss = end(end.initial, control)[1, :2].square().sum() + 0.1 * short.dt * control.square().sum()
        loss.backward()
        expected, gradient = saltus.Simulation(short, "event").loss_and_gradient()
        assert loss.item() == pytest.approx(expected, rel=1e-14)
        np.testing.assert_allclose(control.grad.numpy(), gradient, rtol=1e-9, atol=1e-13)

    def test_float_tensors(self, torch, short):
        import saltus.torch

        end = saltus.torch.EndState(short, "event")
        control = end.control.float().requires_grad_()
        final = end(end.initial.float(), control)
        final.sum().backward()
        assert final.dtype == control.grad.dtype == torch.float32


class TestJax:
    @pytest.fixture(autouse=True)
    def jax(self):
        jax = pytest.importorskip("jax", reason="jax is not installed")
        jax.config.update("jax_enable_x64", True)
        return jax

    def test_losses(self, jax, short):
        import saltus.jax

        batch = saltus.Batch(short, "toi_velocity")
        points = np.stack([scale * saltus.Simulation(short).initial_guess for scale in (0.9, 1.0, 1.1)])
        losses, gradients = batch.loss_and_gradient(points)
        function = saltus.jax.losses(batch)
        np.testing.assert_array_equal(jax.jit(function)(points), losses)
        found = jax.jit(jax.grad(lambda points: function(points) @ np.array([1.0, 2.0, 3.0])))(points)
        np.testing.assert_allclose(found.reshape(3, -1), [[1], [2], [3]] * gradients, rtol=1e-15)

    def test_a_loss_written_in_jax(self, jax, short):
        import saltus.jax

        end, start = saltus.jax.end_state(short, "event"), saltus.EndState(short)

        def loss(control):
            return jax.numpy.sum(end(start.initial, control)[1, :2] ** 2) + 0.1 * short.dt * jax.numpy.sum(control**2)

        found, by_control = jax.value_and_grad(loss)(jax.numpy.asarray(start.control))
        expected, gradient = saltus.Simulation(short, "event").loss_and_gradient()
        assert found == pytest.approx(expected, rel=1e-14)
        np.testing.assert_allclose(by_control, gradient, rtol=1e-9, atol=1e-13)


class TestScipy:
    def test_minimize(self, two_balls):
        """L-BFGS of scipy on the exact gradient, to the optimum that the minimum principle finds."""
        optimize = pytest.importorskip("scipy.optimize")
        simulation = saltus.Simulation(two_balls, "event")
        found = optimize.minimize(
            simulation.loss_and_gradient, simulation.initial_guess.ravel(), jac=True, method="L-BFGS-B",
            options={"maxiter": 2000, "maxfun": 4000, "ftol": 1e-14, "gtol": 1e-9},
        )
        optimum = saltus.solve(two_balls, "event", "hmp")["exact_loss"]
        # The optimum is over forces that may change at the impact; on 480 equal steps it is missed by 1e-4 at most.
        assert optimum - 1e-9 < found.fun < optimum + 1e-4

    def test_least_squares(self, two_balls):
        """One residual pair: the Jacobian is that of the terminal miss."""
        optimize = pytest.importorskip("scipy.optimize")
        scene = two_balls.replace(optimize="velocity", free=["striker"])
        simulation = saltus.Simulation(scene, "event")
        found = optimize.least_squares(
            lambda z: simulation.residuals(z)[0], [1.5, 1.4], jac=lambda z: simulation.residuals(z)[1],
            xtol=1e-15, ftol=1e-15, gtol=1e-15,
        )
        residuals, jacobian = simulation.residuals(found.x)
        assert jacobian.shape == (2, 2)
        assert residuals @ residuals < 1e-20  # the target is hit


class TestPlots:
    @pytest.fixture(autouse=True)
    def pyplot(self):
        pyplot = pytest.importorskip("matplotlib.pyplot")
        yield pyplot
        pyplot.close("all")

    def test_a_trajectory_shows_the_whole_table(self):
        import saltus.plot

        table = saltus.Scene(
            name="table", duration=1, steps=10, optimize="velocity",
            bodies=[{"name": "puck", "radius": 0.1, "mass": 1, "position": [0, 0], "velocity": [1, 0]}],
            segments=[{"name": "gate", "from": [2, 1], "to": [2, 3]}],
            polygons=[{"name": "block", "points": [[-2, 1], [-1, 1], [-1, 2]], "solid": "inside"}],
            arcs=[{"name": "bend", "center": [0, -3], "radius": 1, "from": 3, "to": 7}],
            pockets=[{"name": "hole", "position": [3, -2], "radius": 0.25}],
            objective={"terminal": [{"body": "puck", "quantity": "position", "target": [1, 0], "weight": 1}]})
        ax = saltus.plot.trajectory(table, saltus.rollout(table))
        lines = [np.array(line.get_xydata()) for line in ax.lines]
        assert any(np.array_equal(line, [[2, 1], [2, 3]]) for line in lines)
        assert any(np.array_equal(line, [[-2, 1], [-1, 1], [-1, 2], [-2, 1]]) for line in lines)
        (arc,) = [line for line in lines if len(line) == 100]
        np.testing.assert_allclose(np.hypot(arc[:, 0], arc[:, 1] + 3), 1)
        np.testing.assert_allclose(arc[[0, -1]], [[np.cos(3), np.sin(3) - 3], [np.cos(7), np.sin(7) - 3]])
        assert arc[:, 1].min() < -3.99  # counter-clockwise, by way of the lowest point
        assert any(patch.get_radius() == 0.25 for patch in ax.patches)
        assert ax.get_xlim()[0] < -2 and ax.get_xlim()[1] > 3 and ax.get_ylim()[0] < -3.99 and ax.get_ylim()[1] > 3

    def test_figures(self, two_balls, tmp_path):
        import saltus.plot

        runs = [saltus.solve(two_balls, contact, "gd", iterations=20) for contact in ("direct_toi", "toi_velocity")]
        aligned = saltus.solve(two_balls, "event", "hmp")
        report = saltus.audit(two_balls, ["direct_toi", "event"])
        axes = [
            saltus.plot.trajectory(two_balls, saltus.rollout(two_balls)),
            saltus.plot.controls(two_balls, aligned),
            saltus.plot.losses(runs),
            saltus.plot.audit(report),
            saltus.plot.refinement(report.of("direct_toi")),
        ]
        for i, ax in enumerate(axes):
            ax.figure.savefig(tmp_path / f"{i}.png")
        assert [line.get_label() for line in axes[2].lines] == ["direct_toi gd", "toi_velocity gd"]
        assert axes[2].lines[0].get_color() == saltus.plot.style("direct_toi")["color"] == "#04593F"
        np.testing.assert_array_equal(axes[2].lines[1].get_ydata(), runs[1].losses)
        assert [text.get_text() for text in axes[3].texts] == ["wrong", "right"]
