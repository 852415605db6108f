"""Discs that spin: in dicts, states, gradients and functions."""

import functools

import numpy as np
import pytest
from conftest import SOURCE, run_program, without

import saltus

BACK_SPIN = SOURCE / "problems" / "back_spin.yaml"


@pytest.fixture
def spinning_ball():
    """A ball that strikes the ground twice: its contact point slips, then sticks."""
    return saltus.Scene(
        name="spin_ball", duration=1.4, steps=140, gravity=[0, -9.81], optimize="none",
        bodies=[{"name": "ball", "radius": 0.1, "mass": 1.0, "inertia": "solid", "position": [0, 1],
                 "velocity": [2, -1], "angular_velocity": -60}],
        planes=[{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
        contact={"restitution": 0.8, "friction": 0.15}, objective={"terminal": []},
    )


# Of that ball, exact: the final state, and the rows of its derivative by p_y and the angular velocity.
FINAL = [4.0977935646791584, 0.46169303434099187, 3.3333333333333333, -0.73885009726583886, -58.044128706416833,
         -33.333333333333333]
BY_HEIGHT = [0.061436249124729891, 0.96380290850493784, 0, 7.3583674855730582, 1.2287249824945978, 0]
BY_SPIN = [-0.011903921685786299, 0, -0.033333333333333333, 0, 1.161921566284274, 0.33333333333333333]


def test_states(spinning_ball):
    assert spinning_ball.spins
    np.testing.assert_array_equal(spinning_ball.angular_velocity, [-60])
    np.testing.assert_array_equal(spinning_ball.angle, [0])
    motion = saltus.rollout(spinning_ball)
    assert motion.states.shape == (141, 1, 6)
    np.testing.assert_array_equal(motion.states[0, 0], [0, 1, 2, -1, 0, -60])
    np.testing.assert_allclose(motion.final_state, [FINAL], rtol=1e-11)


def test_another_start(spinning_ball):
    """Turned by 1 rad it does the same, 1 rad further."""
    turned = saltus.rollout(spinning_ball, angle=[1], angular_velocity=[-60]).final_state
    np.testing.assert_allclose(turned[0] - FINAL, [0, 0, 0, 0, 1, 0], atol=1e-9)
    with pytest.raises(ValueError, match=r"angle: found shape \(2,\), expected \(1,\)"):
        saltus.rollout(spinning_ball, angle=[1, 2])


def test_what_cannot_spin_has_no_angle(two_balls):
    assert not two_balls.spins
    with pytest.raises(ValueError, match="angular_velocity"):
        saltus.rollout(two_balls, angular_velocity=[1, 0])


def test_the_end_state_and_its_derivative(spinning_ball):
    end = saltus.EndState(spinning_ball)
    np.testing.assert_array_equal(end.initial, [[0, 1, 2, -1, 0, -60]])
    final = end(end.initial, end.control)
    np.testing.assert_allclose(final, [FINAL], rtol=1e-11)
    for number in range(6):
        by_initial, _ = end.vjp(end.initial, end.control, np.eye(6)[number].reshape(1, 6))
        assert by_initial.shape == (1, 6)
        np.testing.assert_allclose(by_initial[0, [1, 5]], [BY_HEIGHT[number], BY_SPIN[number]], rtol=1e-9, atol=1e-11)


def test_two_discs():
    """An impact that sticks and one with a wall that slips; exact values, and rows of the derivative by the first disc."""
    bodies = [
        {"name": "a", "radius": 0.1, "mass": 1.0, "inertia": "solid", "position": [0, 0], "velocity": [3, 0.5],
         "angular_velocity": 20},
        {"name": "b", "radius": 0.15, "mass": 2.0, "inertia": "solid", "position": [1, 0.25], "velocity": [-0.5, 0],
         "angular_velocity": -10},
    ]
    scene = saltus.Scene(
        name="spin_pair", duration=1.2, steps=120, bodies=bodies, optimize="none", objective={"terminal": []},
        planes=[{"name": "wall", "point": [0, 1], "normal": [0, -1]}], contact={"restitution": 0.9, "friction": 0.2},
    )
    final = [
        [0.17744290792595335, -1.3837991107179555, -0.51380627558836441, -1.5366894042147825, 28.329027743885904,
         24.444444444444444],
        [1.9623567150006118, 0.49729040017692005, 0.86993215099337354, -0.91651023189665211, -8.5713663382192114,
         -3.358905361174403],
    ]
    by_first = {
        (0, 0): [2.0510010514633983, -14.384619911420517, 0.50929589003202614, -3.7168351767292566, 0,
                 0.011862888509299907],
        (0, 5): [80 / 9, -560 / 9, 40 / 9, -160 / 9, 0, 5 / 9],
    }
    end = saltus.EndState(scene)
    np.testing.assert_array_equal(end.initial, [[0, 0, 3, 0.5, 0, 20], [1, 0.25, -0.5, 0, 0, -10]])
    np.testing.assert_allclose(end(end.initial, end.control), final, rtol=1e-11)
    for place, expected in by_first.items():
        cotangent = np.zeros((2, 6))
        cotangent[place] = 1
        by_initial, _ = end.vjp(end.initial, end.control, cotangent)
        np.testing.assert_allclose(by_initial[0], expected, rtol=1e-9, atol=1e-11)


def test_far_from_the_origin(spinning_ball):
    """Positions pass through another origin; angles and spins do not."""
    data = spinning_ball.to_dict()
    data["bodies"][0]["position"] = [4096, 1]
    end = saltus.EndState(saltus.Scene(data))
    np.testing.assert_array_equal(end.initial, [[4096, 1, 2, -1, 0, -60]])
    np.testing.assert_allclose(end(end.initial, end.control) - [4096, 0, 0, 0, 0, 0], [FINAL], rtol=1e-11)


def test_linearization(spinning_ball):
    A, B = saltus.linearize(spinning_ball)
    assert A.shape == (140, 6, 6) and B.shape == (140, 6, 0, 2)
    product = functools.reduce(np.matmul, A[::-1])
    np.testing.assert_allclose(product[:, 1], BY_HEIGHT, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(product[:, 5], BY_SPIN, rtol=1e-9, atol=1e-11)


def test_launch_velocity_and_spin_are_optimised():
    simulation = saltus.Simulation(BACK_SPIN)
    assert simulation.shape == (3,)
    np.testing.assert_array_equal(simulation.initial_guess, [2, 2, 60])
    loss, gradient = simulation.loss_and_gradient()
    everything = saltus.loss_and_gradient(BACK_SPIN)
    assert loss == everything["loss"]
    assert everything.gradient.angular_velocity.shape == everything.gradient.angle.shape == (1,)
    expected = [*everything.gradient.velocity[0], *everything.gradient.angular_velocity]
    np.testing.assert_allclose(gradient, expected, rtol=1e-12)
    batch = saltus.Batch(BACK_SPIN)
    np.testing.assert_array_equal(batch.loss_and_gradient(simulation.initial_guess[None])[1][0], gradient)


@pytest.mark.parametrize("contact", ["event", "compliant_brax", "pbd_brax"])
def test_numbers_are_those_of_the_programs(contact):
    flags = [f"--scene={BACK_SPIN}", f"--contact={contact}"]
    printed = run_program("saltus_audit", *flags)
    assert saltus.audit(BACK_SPIN, contact=[contact]).to_dict() == printed
    printed = run_program("saltus_solve", *flags, "--solver=gd", "--iterations=20")["runs"][0]
    run = saltus.solve(BACK_SPIN, contact, "gd", iterations=20)
    assert without(run.to_dict(), "seconds") == without(printed, "seconds")
    assert run.angular_velocity.shape == (1,)


def test_who_knows_no_angles_refuses(spinning_ball):
    class Own(saltus.ContactModel):
        def step(self, x, u, h):
            return x

    with pytest.raises(ValueError, match="spin"):
        saltus.rollout(spinning_ball, Own)
    with pytest.raises(ValueError, match="spin"):
        saltus.rollout(spinning_ball.replace(contact={"friction": 0}), "static_lcp")
    with pytest.raises(ValueError, match="spin"):
        saltus.audit(spinning_ball, simulate=lambda scene, initial, control, dt: initial)


def test_a_spoke_shows_the_angle(spinning_ball):
    pytest.importorskip("matplotlib", reason="python3-matplotlib is not installed")
    import saltus.plot

    ax = saltus.plot.trajectory(spinning_ball, saltus.rollout(spinning_ball))
    _, start, end, _ = ax.lines  # a path first, the ground last
    np.testing.assert_allclose(start.get_xydata(), [[0, 1], [0.1, 1]], atol=1e-15)
    centre, rim = end.get_xydata()
    np.testing.assert_allclose(rim - centre, 0.1 * np.array([np.cos(FINAL[4]), np.sin(FINAL[4])]), atol=1e-9)


def test_torch(spinning_ball):
    torch = pytest.importorskip("torch", reason="python3-torch is not installed")
    import saltus.torch

    end = saltus.torch.EndState(spinning_ball)
    initial = end.initial.requires_grad_()
    assert torch.autograd.gradcheck(lambda initial: end(initial, end.control), (initial,), eps=1e-6, atol=1e-5)


@pytest.fixture
def turned_pair():
    """Two discs that are pushed, of which the second is turned too."""
    return saltus.Scene(
        name="turned", duration=1, steps=8, optimize="control",
        bodies=[{"name": "a", "radius": 0.3, "mass": 1, "position": [0, 0]},
                {"name": "b", "radius": 0.3, "mass": 2, "position": [2, 0], "inertia": "solid"}],
        control={"bodies": ["a", "b"], "torque": ["b"], "initial": [[0.1, 0], [0, 0.2, 0.02]]},
        objective={"terminal": [{"body": "b", "quantity": "angle", "target": 1},
                                {"body": "a", "quantity": "position", "target": [0.5, 0]}], "effort": 0.1},
    )


def test_torques_are_a_third_column(turned_pair):
    """The loss, and its derivative by every number of a control, against differences."""
    assert turned_pair.turned == ["b"]
    simulation = saltus.Simulation(turned_pair)
    assert simulation.shape == (8, 2, 3) and simulation.num_variables == 48
    z = simulation.initial_guess
    np.testing.assert_array_equal(z[0], [[0.1, 0, 0], [0, 0.2, 0.02]])
    z[:, 1, 2] *= np.linspace(1, 2, 8)
    loss, gradient = simulation.loss_and_gradient(z)
    assert saltus.rollout(turned_pair, control=z).loss == loss
    moved = z.copy()
    for k in (0, 5):
        for column in range(3):
            moved[k, 1, column] += 1e-5
            above = simulation.loss(moved)
            moved[k, 1, column] -= 2e-5
            np.testing.assert_allclose((above - simulation.loss(moved)) / 2e-5, gradient[k, 1, column], rtol=1e-6, atol=1e-9)
            moved[k, 1, column] = z[k, 1, column]
    np.testing.assert_array_equal(gradient[:, 0, 2], 0)
    np.testing.assert_array_equal(saltus.loss_and_gradient(turned_pair, control=z).gradient.control[:, 1], gradient[:, 1])
    losses, gradients = saltus.Batch(turned_pair).loss_and_gradient(np.array([z, 2 * z]))
    assert losses[0] == loss
    np.testing.assert_array_equal(gradients[0], gradient.ravel())
    end = saltus.EndState(turned_pair)
    _, by_control = end.vjp(end.initial, z, [[0] * 6, [0, 0, 0, 0, 0, 1]])
    np.testing.assert_allclose(by_control[:, 1, 2], 0.125 / (0.5 * 2 * 0.09), rtol=1e-12)
    _, B = saltus.linearize(turned_pair, control=z)
    assert B.shape == (8, 12, 2, 3)
    np.testing.assert_allclose(B[3, 11, 1], [0, 0, 0.125 / 0.09], rtol=1e-12)
    z[2, 0, 2] = 1
    with pytest.raises(ValueError, match="found a torque on a in interval 2, expected 0"):
        simulation.loss(z)


def test_optimal_torques(turned_pair):
    run = saltus.solve(turned_pair, "event", "ceres_lm")
    assert run.converged and run.control.shape == (8, 2, 3)
    np.testing.assert_array_equal(run.control[:, 0, 2], 0)
    simulation = saltus.Simulation(turned_pair)
    loss, gradient = simulation.loss_and_gradient(run.control)
    np.testing.assert_allclose(loss, run.final_loss, rtol=1e-12)
    np.testing.assert_allclose(gradient, 0, atol=1e-6)
