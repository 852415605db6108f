"""The probability that the sequence of events of a hybrid system changes: events at one time, grazes, near misses."""

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
