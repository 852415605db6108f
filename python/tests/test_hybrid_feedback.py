"""The probability that the sequence of events of a hybrid system changes: events at one time, grazes, near misses."""

import copy

import numpy as np
import pytest

import saltus


def beads(right):
    def hit(x, i):
        a, v, w = list(x), x[3 + i], x[4 + i]
        a[3 + i], a[4 + i] = (v + w) / 2 - 0.35 * (v - w), (v + w) / 2 + 0.35 * (v - w)
        return "m", a

    system = saltus.HybridSystem(
        states={"m": ["a", "b", "c", "u", "v", "w"]}, controls=["f"], flow={"m": lambda t, x, u, p: [x[3], x[4], x[5], u[0], 0, 0]},
        guards={"m": {"ab": lambda t, x, p: x[1] - x[0], "bc": lambda t, x, p: x[2] - x[1]}},
        resets={"m": {"ab": lambda t, x, p: hit(x, 0), "bc": lambda t, x, p: hit(x, 1)}})
    return saltus.HybridProblem(system, mode="m", initial=[-1, 0, right, 1, 0, -1], duration=2.0, control=np.zeros((3, 1)))


def landing(height):
    system = saltus.HybridSystem(
        states={"m": ["y", "v"]}, controls=["f"], flow={"m": lambda t, x, u, p: [x[1], 2.0 + u[0]]},
        guards={"m": {"floor": lambda t, x, p: x[0]}}, resets={"m": {"floor": lambda t, x, p: ("m", [x[0], -0.5 * x[1]])}})
    return saltus.HybridProblem(system, mode="m", initial=[height, -2.0], duration=2.0, control=np.zeros((3, 1)))


@pytest.mark.parametrize("problem, least, most", [
    (beads(1.0), 0.45, 1.0), (beads(1.001), 0.4, 1.0), (beads(1.5), 0.0, 1e-6),
    (landing(1.0), 0.45, 0.55), (landing(1.005), 0.25, 0.4), (landing(1.5), 0.0, 1e-6),
])
def test_the_probability_that_the_sequence_changes(problem, least, most):
    """Ties, grazes and near misses, against the share of noisy runs with other events."""
    noise = 1e-4 * np.eye(len(problem.initial))
    found = saltus.propagate(problem, initial=noise)
    runs = saltus.noisy_runs(problem, initial=noise, samples=400)
    assert least <= found.change_probability <= most
    assert runs.otherwise / 400 <= found.change_probability + 0.08
    assert bool(found.warning) == (least > 0)


def test_a_covariance_without_columns_is_refused():
    with pytest.raises(ValueError, match="control"):
        saltus.noisy_runs(beads(1.5), initial=1e-4 * np.eye(6), control=np.empty((3, 0)), samples=5)


def test_what_is_no_matrix_is_refused_by_its_name():
    problem = beads(1.5)
    with pytest.raises(ValueError, match=r"^R: found shape \(\), expected a matrix"):
        saltus.track(problem, np.eye(6), 1, np.eye(6))
    with pytest.raises(ValueError, match=r"^process: found shape \(6,\), expected a matrix"):
        saltus.propagate(problem, process=np.ones(6))


def test_a_filter_of_a_mechanical_system_is_that_of_its_hybrid_system():
    """A bouncing ball as a mechanical system, whose mode is found, beside the same ball with a flow, a guard and a reset."""
    mechanical = saltus.MechanicalSystem(
        coordinates=["y"], controls=["f"], parameters=["e"], mass=lambda q: [[2.0]], force=lambda u: [u[0] - 19.6],
        contacts={"ground": saltus.Contact(gap=lambda q: q[0], restitution="e")})
    hybrid = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["f"], parameters=["e"],
        flow={"flight": lambda x, u: [x[1], u[0] / 2 - 9.8]}, guards={"flight": {"ground": lambda x: x[0]}},
        resets={"flight": {"ground": lambda x, p: ("flight", [x[0], -p[0] * x[1]])}})
    P = np.array([[0.02, 0.01], [0.01, 0.04]])
    found = [saltus.SaltedKalmanFilter(system, [1.0, 0.5], P, parameters=[0.6]) for system in (mechanical, hybrid)]
    for time, position in ((0.3, 0.75), (0.7, 0.42), (1.1, 0.1)):
        for estimate in found:
            estimate.predict(time, [0.3], 1e-3 * np.eye(2))
            estimate.update([position], [[1.0, 0.0]], [[0.01]])
        np.testing.assert_allclose(found[0].mean, found[1].mean, rtol=1e-9)
        np.testing.assert_allclose(found[0].covariance, found[1].covariance, rtol=1e-9)
    assert (found[0].mode, found[1].mode) == ("o", "flight")


def test_a_filter_of_a_mechanical_system_follows_contacts_that_stay():
    """Without restitution the ball stays on the ground, and its height is known from then on."""
    system = saltus.MechanicalSystem(
        coordinates=["x", "y"], mass=lambda q: np.eye(2), force=lambda q: [0.0, -9.8],
        contacts={"ground": saltus.Contact(gap=lambda q: q[1], restitution=0.0)})
    estimate = saltus.SaltedKalmanFilter(system, [0, 1, 3, 0], np.diag([0.04, 0.01, 0.09, 0.01]))
    assert estimate.mode == "o"
    estimate.predict(1.0)
    assert estimate.mode == "n"
    np.testing.assert_allclose(estimate.mean, [3, 0, 3, 0], atol=1e-12)
    np.testing.assert_allclose(estimate.covariance, [[0.13, 0, 0.09, 0], [0] * 4, [0.09, 0, 0.09, 0], [0] * 4], atol=1e-12)
    again = copy.copy(estimate)
    assert (again.mode, again.time) == ("n", 1.0)
    with pytest.raises(ValueError, match="mode: found 'x', expected a letter for each of 1 contacts"):
        saltus.SaltedKalmanFilter(system, [0, 1, 3, 0], np.eye(4), mode="x")
    with pytest.raises(ValueError, match="mean: contact 'ground' is closed in mode 'n', and its gap is 1"):
        saltus.SaltedKalmanFilter(system, [0, 1, 3, 0], np.eye(4), mode="n")


def test_a_filter_passes_switches():
    """The name of the mode is that of the system, on either side of a switch of its flow."""
    system = saltus.HybridSystem(states={"m": ["x"]}, flow={"m": lambda x: [saltus.where(x[0] < 1, 1.0, 3.0)]})
    estimate = saltus.SaltedKalmanFilter(system, [0.5], [[0.01]])
    estimate.predict(1.0)
    assert estimate.mode == "m"
    np.testing.assert_allclose([estimate.mean[0], estimate.covariance[0, 0]], [2.5, 0.09], rtol=1e-12)


def test_the_closed_loop_sees_a_pulse_of_the_flow():
    """A push of 1 N s that lasts about 1e-4 s moves the plant, too, and the branches before and after an event."""
    width = 1e-4
    push = lambda t, at: np.exp(-(((t - at) / width) ** 2)) / (width * np.sqrt(np.pi))
    system = saltus.HybridSystem(
        states={"m": ["x", "v"]},
        controls=["u"],
        flow={"m": lambda t, x, u: [x[1], u[0] + push(t, 0.33) - 2 * push(t, 0.71)]},
        guards={"m": {"wall": lambda x: 0.3 - x[0]}},
        resets={"m": {"wall": lambda x: ("m", [x[0], -x[1]])}},
    )
    problem = saltus.HybridProblem(system, mode="m", initial=[0.0, 0.0], duration=1.0, control=np.zeros((8, 1)))
    motion = saltus.rollout(problem)
    assert len(motion.events) == 1 and abs(motion.events[0][0] - 0.63) < 1e-6
    runs = saltus.noisy_runs(problem, initial=1e-20 * np.eye(2), samples=4)
    assert runs.otherwise == 0
    assert np.allclose(runs.mean, motion.final, rtol=0, atol=1e-8)
