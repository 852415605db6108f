"""Wrong arguments end in exceptions, never the interpreter, and calls do not use up memory."""

import os
import subprocess
import sys

import numpy as np
import pytest
from conftest import SOURCE, load_campaign

import saltus

NAN, INF = float("nan"), float("inf")


def falling(**changes):
    return saltus.HybridSystem(**{
        "states": {"m": ["y", "v"]}, "controls": ["u"], "parameters": ["g"], "flow": {"m": lambda t, x, u, p: [x[1], u[0] - p[0]]},
        **changes})


def estimate(mean=(1, 0), covariance=None, parameters=(9.8,), **changes):
    covariance = 0.01 * np.eye(2) if covariance is None else covariance
    return saltus.SaltedKalmanFilter(falling(), mean, covariance, parameters=parameters, **changes)


class TestFilters:
    @pytest.mark.parametrize("arguments, words", [
        ({"mean": (NAN, 0)}, r"mean\[0\]: found nan"), ({"mean": (1, INF)}, r"mean\[1\]: found inf"),
        ({"mean": (1, 0, 0)}, r"mean: found shape \(3,\), expected \(2,\)"), ({"mean": 1.0}, r"mean: found shape \(1,\)"),
        ({"covariance": np.eye(3)}, r"covariance: found shape \(3, 3\), expected \(2, 2\)"),
        ({"covariance": [[1, 0], [NAN, 1]]}, r"covariance\[1, 0\]: found nan"),
        ({"covariance": [[1, 0], [0.5, 1]]}, "covariance: found a matrix that is not symmetric"),
        ({"covariance": -np.eye(2)}, "covariance: found the eigenvalue -1"),
        ({"parameters": (NAN,)}, r"parameters\[0\]: found nan"), ({"parameters": (1, 2)}, r"parameters: found shape \(2,\)"),
        ({"parameters": ()}, r"parameters: found shape \(0,\), expected \(1,\)"), ({"time": NAN}, "time: found nan"),
        ({"time": -INF}, "time: found -inf"), ({"mode": "n"}, "mode: found 'n', expected some of m"),
    ])
    def test_estimates(self, arguments, words):
        with pytest.raises(ValueError, match=words):
            estimate(**arguments)

    @pytest.mark.parametrize("arguments, words", [
        ({"time": INF}, "time: found inf"), ({"time": NAN}, "time: found nan"), ({"time": -1.0}, "time: found -1"),
        ({"control": [NAN]}, r"control\[0\]: found nan"), ({"control": [1, 2]}, r"control: found shape \(2,\), expected \(1,\)"),
        ({"control": []}, r"control: found shape \(0,\)"), ({"process": np.eye(3)}, r"process: found shape \(3, 3\), expected \(2, 2\)"),
        ({"process": [[1, 0], [0, NAN]]}, r"process\[1, 1\]: found nan"), ({"process": -np.eye(2)}, "process: found the eigenvalue -1"),
        ({"process": 1.0}, r"process: found shape \(\)"), ({"process": [1, 2, 3]}, "process: found shape"),
    ])
    def test_predictions(self, arguments, words):
        predicted = estimate()
        with pytest.raises(ValueError, match=words):
            predicted.predict(**{"time": 0.1, **arguments})
        assert predicted.time == 0 and predicted.mean.tolist() == [1, 0]

    @pytest.mark.parametrize("arguments, words", [
        ({"z": [NAN]}, r"z\[0\]: found nan"), ({"z": [0.9, 1]}, r"C: found shape \(1, 2\), expected \(2, 2\)"),
        ({"z": []}, "C: found shape"), ({"C": [[1, 0, 0]]}, r"C: found shape \(1, 3\), expected \(1, 2\)"),
        ({"C": [[1, 0, 0]], "h": [1]}, r"C: found shape"), ({"C": [[1, INF]]}, r"C\[0, 1\]: found inf"),
        ({"V": [[-1]]}, "V: found the eigenvalue -1"), ({"V": np.eye(2)}, r"V: found shape \(2, 2\), expected \(1, 1\)"),
        ({"V": [[NAN]]}, r"V\[0, 0\]: found nan"), ({"h": [1, 2]}, r"h: found shape \(2,\), expected \(1,\)"),
        ({"h": [INF]}, r"h\[0\]: found inf"), ({"C": [[0, 0]], "V": [[0]]}, "is not positive definite"),
        ({"C": [[1e300, 0]]}, "not positive definite|too large"), ({"z": [1e308], "h": [-1e308]}, "too large"),
    ])
    def test_measurements(self, arguments, words):
        measured = estimate()
        with pytest.raises(ValueError, match=words):
            measured.update(**{"z": [0.9], "C": [[1, 0]], "V": [[1]], **arguments})
        assert measured.mean.tolist() == [1, 0] and measured.covariance.tolist() == [[0.01, 0], [0, 0.01]]

    def test_types(self):
        for arguments in ({"z": ["a"]}, {"z": [1j]}, {"C": "text"}, {"V": None}, {"h": object()}):
            with pytest.raises(TypeError):
                estimate().update(**{"z": [0.9], "C": [[1, 0]], "V": [[1]], **arguments})
        with pytest.raises(TypeError, match="time: found str, expected a number"):
            estimate().predict("later")

    def test_motions_that_leave_the_range_of_numbers(self):
        grows = falling(flow={"m": lambda t, x, u, p: [1e3 * x[0], 0 * x[1]]})
        large = saltus.SaltedKalmanFilter(grows, [1.0, 0], np.eye(2), parameters=[0])
        with pytest.raises(RuntimeError):
            large.predict(2.0)
        with pytest.raises(RuntimeError, match="the covariance at t = 0.5 is too large"):
            large.predict(0.5)
        assert large.time == 0 and np.all(np.isfinite(large.covariance))

    def test_modes_of_other_sizes(self):
        """The size of the process noise is that of the state at the end."""
        lands = saltus.HybridSystem(
            states={"flight": ["y", "v"], "rest": ["y"]},
            flow={"flight": lambda t, x, u, p: [x[1], -9.8], "rest": lambda t, x, u, p: [0]},
            guards={"flight": {"ground": lambda t, x, p: x[0]}}, resets={"flight": {"ground": lambda t, x, p: ("rest", [x[0]])}})
        falls = saltus.SaltedKalmanFilter(lands, [1.0, 0], 0.01 * np.eye(2))
        with pytest.raises(ValueError, match="process: found shape"):
            falls.predict(1.0, process=np.eye(3))
        with pytest.raises(RuntimeError, match="process: found a matrix of 2 x 2, expected 1 x 1"):
            falls.predict(1.0, process=np.eye(2))
        falls.predict(1.0, process=np.eye(1))
        assert falls.mode == "rest" and falls.mean.shape == (1,)

    @pytest.mark.parametrize("arguments", [
        {"mean": [NAN] + [0] * 7}, {"mean": [0] * 4}, {"covariance": np.eye(4)}, {"covariance": -np.eye(8)}, {"time": NAN}])
    def test_scenes(self, two_balls, arguments):
        given = {"mean": [-2, -2, 1, 1, -1, -1, 0, 0], "covariance": 0.01 * np.eye(8), **arguments}
        with pytest.raises(ValueError):
            saltus.SaltedKalmanFilter(two_balls, **given)

    @pytest.mark.parametrize("duration", [1e-310, 1e-30, 1e9, 1e300])
    def test_durations_of_scenes(self, two_balls, duration):
        moved = saltus.SaltedKalmanFilter(two_balls, [-2, -2, 1, 1, -1, -1, 0, 0], 0.01 * np.eye(8))
        try:
            moved.predict(duration)
        except (RuntimeError, ValueError):
            assert moved.time == 0
        assert np.all(np.isfinite(moved.mean)) and np.all(np.isfinite(moved.covariance))


class TestFeedback:
    @staticmethod
    def problem():
        return saltus.HybridProblem(
            falling(guards={"m": {"ground": lambda t, x, p: x[0]}}, resets={"m": {"ground": lambda t, x, p: ("m", [0, -0.7 * x[1]])}}),
            mode="m", initial=[1, 0], parameters=[9.8], duration=0.8, control=np.zeros((4, 1)))

    @pytest.mark.parametrize("value", [NAN, INF, -INF])
    def test_gains_that_are_not_finite(self, two_balls, value):
        for problem, n, m in ((self.problem(), 2, 1), (two_balls.replace(steps=8), 8, 2)):
            regulator = saltus.track(problem, np.eye(n), np.eye(m), np.eye(n))
            gains = [gain.copy() for gain in regulator.gains]
            gains[2][0, 1] = value
            wrong = saltus.Regulator({**regulator, "gains": gains})
            for call in (saltus.propagate, saltus.noisy_runs):
                with pytest.raises(ValueError, match="gains: that of interval 2 has a number that is not finite"):
                    call(problem, 0.01 * np.eye(n), regulator=wrong)

    def test_gains_that_leave_the_range_of_numbers(self):
        problem = self.problem()
        regulator = saltus.track(problem, np.eye(2), np.eye(1), np.eye(2))
        huge = saltus.Regulator({**regulator, "gains": [1e200 * gain for gain in regulator.gains]})
        runs = saltus.noisy_runs(problem, 0.01 * np.eye(2), regulator=huge, samples=8)
        assert runs.failed == 8 and runs.counted == 0

    @pytest.mark.parametrize("q, r, qt", [(1, 1e-30, 1e30), (1e300, 1e-300, 1), (1e25, 1e-25, 1e25), (1e-300, 1e300, 1e-300), (0, 1, 0)])
    def test_weights_of_any_ratio(self, two_balls, q, r, qt):
        """A regulator whose gains are those of the weights, or a refusal; never an end of the interpreter."""
        for problem, n, m in ((self.problem(), 2, 1), (two_balls.replace(steps=8), 8, 2)):
            try:
                regulator = saltus.track(problem, q * np.eye(n), r * np.eye(m), qt * np.eye(n))
            except ValueError as error:
                assert "the weights of the regulator differ too much" in str(error)
                continue
            assert all(np.all(np.isfinite(gain)) for gain in regulator.gains)
            if q == 0:
                assert all(np.all(gain == 0) for gain in regulator.gains)


# What a script of a campaign does, in a process of its own.
def run_script(folder, name, *flags, minutes=10):
    return subprocess.run(
        [sys.executable, SOURCE / "tests" / folder / f"{name}.py", *flags], capture_output=True, text=True, check=False,
        timeout=60 * minutes)


def test_calls_with_anything():
    done = run_script("fuzz", "python_calls", "--count=600", "--seed=3")
    assert done.returncode == 0 and "unexpected" not in done.stdout, done.stdout + done.stderr
    assert "0 did not end, 0 ended the interpreter" in done.stdout


@pytest.mark.skipif("lib" in os.environ.get("LD_PRELOAD", ""), reason="sanitizers keep what is freed")
def test_memory_does_not_grow_with_calls_of_any_kind():
    leaks = load_campaign("python_leaks")
    calls = leaks.entries()
    counts = {"audit": 3, "identify": 30, "noisy_runs": 200}
    for name, call in calls.items():
        count = counts.get(name, 300)
        grown = leaks.growth(call, count)
        assert grown < 300 + count * 0.5, f"{name}: {grown} KiB over {count} calls"
