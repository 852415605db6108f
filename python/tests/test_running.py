"""Callbacks, Ctrl-C, threads and memory."""

import concurrent.futures
import functools
import gc
import io
import os
import resource
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from conftest import run_program, scene_of

import saltus
from saltus import _progress


def interrupt_soon(seconds=0.3):
    """Ctrl-C from another thread; the computation must take longer."""
    timer = threading.Timer(seconds, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    return timer


class TestCallbacks:
    def test_is_told_every_iteration(self, two_balls):
        seen = []
        run = saltus.solve(two_balls, "direct_toi", "gd", iterations=5, callback=lambda k, loss: seen.append((k, loss)))
        assert [k for k, _ in seen] == list(range(6))
        np.testing.assert_array_equal([loss for _, loss in seen], run.losses)

    @pytest.mark.parametrize("iterations", [0, 1, 2, 6])
    @pytest.mark.parametrize("solver", ["hmp", "mode_search", "ceres_phases"])
    def test_no_more_iterations_than_allowed(self, two_balls, solver, iterations):
        seen = []
        run = saltus.solve(two_balls, "event", solver, iterations=iterations, callback=lambda k, loss: seen.append(k))
        assert run["iterations"] == max(seen) == len(run.losses) - 1 <= iterations

    def test_false_ends_the_run(self, two_balls):
        run = saltus.solve(two_balls, "direct_toi", "gd", callback=lambda k, loss: k < 7)
        assert run["termination"] == "interrupted" and run["iterations"] == 7

    @pytest.mark.parametrize("solver", ["gd", "ceres_lbfgs", "ceres_lm", "ceres_shooting"])
    def test_an_exception_comes_out_with_the_run(self, two_balls, solver):
        def fail(iteration, loss):
            if iteration == 1:
                raise ZeroDivisionError("mine")

        with pytest.raises(ZeroDivisionError, match="mine") as caught:
            saltus.solve(two_balls, "direct_toi", solver, callback=fail)
        assert caught.value.run["termination"] == "interrupted"

    @pytest.mark.parametrize("answer", ["yes", 1, 0.0, [], np.zeros(3)])
    def test_rubbish(self, two_balls, answer):
        with pytest.raises(TypeError, match="callback: found .*expected True, False or None"):
            saltus.solve(two_balls, "direct_toi", "gd", callback=lambda k, loss: answer)

    def test_not_callable(self, two_balls):
        with pytest.raises(TypeError):
            saltus.solve(two_balls, "direct_toi", "gd", callback=3)


class TestInterrupts:
    def test_a_solve_keeps_what_it_has(self, two_balls):
        timers = []

        def begin(iteration, loss):
            if iteration == 1:
                timers.append(interrupt_soon())

        with pytest.raises(KeyboardInterrupt) as caught:
            saltus.solve(two_balls, "ncp", "gd", iterations=10_000_000, callback=begin)
        timers[0].join()
        assert caught.value.run["termination"] == "interrupted"
        assert caught.value.run["iterations"] >= 1

    def test_batches_and_audits(self, two_balls):
        timer = interrupt_soon()
        with pytest.raises(KeyboardInterrupt):
            saltus.Batch(two_balls, "ncp").loss_and_gradient(np.full((20_000, 960), 3.0))
        timer.join()
        timer = interrupt_soon()
        with pytest.raises(KeyboardInterrupt) as caught:
            saltus.audit(two_balls.replace(steps=96_000), "all")
        timer.join()
        assert isinstance(caught.value.audit, saltus.Audit)

    def test_an_audit_keeps_the_models_that_it_has_judged(self, two_balls):
        calls = []

        def simulate(scene, initial, control, dt):
            calls.append(1)
            if len(calls) == 3:
                raise KeyboardInterrupt
            return initial

        expected = saltus.audit(two_balls, "toi_velocity").of("toi_velocity")
        with pytest.raises(KeyboardInterrupt) as caught:
            saltus.audit(two_balls, "toi_velocity", simulate=simulate)
        kept = caught.value.audit
        assert kept.of("toi_velocity").to_dict() == expected.to_dict()
        assert kept.verdicts.get("simulate", "interrupted") == "interrupted"

    def test_another_handler(self, two_balls):
        def handler(number, frame):
            raise LookupError("alarm")

        before = signal.signal(signal.SIGALRM, handler)
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.3)
            with pytest.raises(LookupError, match="alarm"):
                saltus.solve(two_balls, "ncp", "gd", iterations=10_000_000)
        finally:
            signal.signal(signal.SIGALRM, before)

    @pytest.mark.parametrize("function", [
        saltus.rollout, saltus.final_derivatives, saltus.loss_and_gradient,
        lambda problem: saltus.solve(problem, solver="gd", optimize=["x"])])
    def test_a_rollout_of_a_hybrid_system(self, function):
        """Each step asks for an interrupt; all of them would take a minute."""
        system = saltus.HybridSystem(states={"m": ["x", "v"]}, parameters=["w"], flow={"m": lambda x, p: [x[1], -p[0] ** 2 * x[0]]})
        problem = saltus.HybridProblem(system, mode="m", initial=[1, 0], parameters=[1000.0], duration=1e4,
                                       costs=[saltus.terminal([0, 0], mode="m")], steps_per_interval=2**24)
        timer = interrupt_soon()
        with pytest.raises(KeyboardInterrupt):
            function(problem)
        timer.join()

    def test_a_prediction_of_a_filter(self):
        """It would take millions of steps."""
        system = saltus.HybridSystem(states={"m": ["x", "v"]}, parameters=["w"],
                                     flow={"m": lambda x, p: [x[1], -p[0] ** 2 * np.sin(x[0])]})
        found = saltus.SaltedKalmanFilter(system, [0.1, 0], np.eye(2), mode="m", parameters=[1000.0])
        timer = interrupt_soon()
        with pytest.raises(KeyboardInterrupt):
            found.predict(20.0)
        timer.join()
        np.testing.assert_array_equal(found.mean, [0.1, 0])
        assert found.time == 0

    @pytest.mark.parametrize("intervals", [1, 2, 3, 4, 1000])
    @pytest.mark.parametrize("function", [saltus.rollout, saltus.final_derivatives, saltus.loss_and_gradient])
    def test_more_steps_than_fit_into_memory(self, function, intervals):
        system = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda u: [u[0]]})
        problem = saltus.HybridProblem(system, mode="m", initial=[1], duration=1, control=np.zeros((intervals, 1)),
                                       steps_per_interval=2**31 - 1)
        with pytest.raises(RuntimeError, match=f"2147483647 integration steps in each of {intervals} control intervals, "
                                               "expected at most 16777216 in all"):
            function(problem)


class TestThreads:
    def test_one_simulation_for_several(self, two_balls):
        simulation = saltus.Simulation(two_balls, "direct_toi")
        points = 3 + np.random.default_rng(3).normal(size=(200, 960))
        alone = [simulation.loss(point) for point in points]
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            assert list(pool.map(simulation.loss, points)) == alone

    def test_python_goes_on_meanwhile(self, two_balls):
        counted = 0
        done = threading.Event()

        def solve():
            saltus.solve(two_balls, "ncp", "gd", iterations=20)
            done.set()

        thread = threading.Thread(target=solve)
        thread.start()
        while not done.wait(0.001):
            counted += 1
        thread.join()
        assert counted > 0

    def test_a_run_in_another_thread_ends_by_its_callback(self, two_balls):
        stop = threading.Event()
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            future = pool.submit(
                saltus.solve, two_balls, "direct_toi", "gd", iterations=10_000_000, callback=lambda k, loss: not stop.is_set()
            )
            stop.set()
            assert future.result()["termination"] == "interrupted"


@pytest.mark.skipif("libasan" in os.environ.get("LD_PRELOAD", ""), reason="AddressSanitizer keeps what is freed")
def test_memory_does_not_grow(two_balls):
    """10^6 calls, each of which counts references; warmed up first."""
    simulation = saltus.Simulation(two_balls.replace(steps=4), "direct_toi")
    z, out = simulation.initial_guess, np.zeros(simulation.shape)
    wrong = np.zeros(7)

    def calls(count):
        for _ in range(count):
            simulation.loss_and_gradient(z, out)
            simulation.loss_and_gradient(z)
        for _ in range(count // 100):
            with pytest.raises(ValueError):
                simulation.loss(wrong)
            simulation.rollout()
        gc.collect()

    calls(20_000)
    references = sys.getrefcount(z), sys.getrefcount(out), sys.getrefcount(simulation)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    calls(500_000)
    assert (sys.getrefcount(z), sys.getrefcount(out), sys.getrefcount(simulation)) == references
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 4096  # KiB: 4 bytes a call


def test_nothing_is_printed(tmp_path):
    code = (
        "import saltus, os; s = saltus.load_scene(os.environ['SALTUS_SOURCE'] + '/problems/two_balls.yaml');"
        "saltus.solve(s, 'event', 'ceres_lm', callback=lambda k, loss: False); saltus.audit(s, ['event', 'lcp'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "" and done.stderr == ""


def test_pages_show_the_duration_that_was_found(tmp_path):
    scene = scene_of("two_balls").to_dict()
    scene["objective"]["duration"] = {"free": True, "min": 0.3, "max": 1.5, "weight": 0.5}
    scene["steps"] = 20
    path = tmp_path / "scene.yaml"
    path.write_text(saltus.Scene(scene).to_yaml(), encoding="utf-8")
    document = run_program("saltus_solve", f"--scene={path}", "--contact=event", "--solver=ceres_phases", f"--output_dir={tmp_path}")
    duration = document["runs"][0]["duration"]
    assert duration != 1.0 and duration == pytest.approx(sum(document["runs"][0]["durations"]))
    (page,) = [file.read_text(encoding="utf-8") for file in tmp_path.glob("*.html")]
    assert '"subtitle":"20 steps over a free duration, given as 1 s"' in page
    assert f'"value":"{duration:.6g} s","label":"duration, by event ceres_phases"' in page


LONG = 10_000_000  # iterations, which would take days


class TestLimitsOfTime:
    def test_a_solve_ends_with_what_it_has(self, two_balls):
        run = saltus.solve(two_balls, "ncp", "gd", iterations=LONG, seconds=0.3)
        assert run["termination"] == "interrupted" and run["iterations"] >= 1 and run["exact_loss"] > 1
        assert run["reason"] == "the limit of 0.3 s was reached; raise seconds, or go on from what was found"
        assert saltus.solve(two_balls, "direct_toi", "gd", iterations=3, seconds=1000)["termination"] == "iteration_limit"

    def test_a_hybrid_solve(self):
        ball = saltus.HybridSystem(
            states={"m": ["y", "v"]}, controls=["f"], flow={"m": lambda x, u: [x[1], u[0] - 9.8]},
            guards={"m": {"ground": lambda x: x[0]}}, resets={"m": {"ground": lambda x: ("m", [x[0], -0.7 * x[1]])}})
        problem = saltus.HybridProblem(ball, mode="m", initial=[1, 0], duration=1.0, control=np.zeros((50, 1)),
                                       costs=[saltus.terminal([0.5, 0]), saltus.effort(0.1)])
        run = saltus.solve(problem, solver="gd", learning_rate=1e-9, iterations=LONG, seconds=0.3)
        assert run.termination == "interrupted" and run.iterations >= 1 and len(run.events) == 1
        assert "the limit of 0.3 s was reached" in run.reason

    def test_a_fit(self):
        scene = scene_of("two_balls")
        noise = np.random.default_rng(1).normal(size=(2000, 2))  # no motion fits
        recording = {"time": np.linspace(0.01, 0.99, 2000), "body": ["striker"] * 2000, "position": noise, "sigma": 1e-3}
        fit = saltus.identify(scene.replace(steps=30_000), recording, "restitution", "ncp", starts=1000, seconds=0.5)
        assert fit["verdict"] == "interrupted" and "the limit of 0.5 s was reached" in fit.reason

    def test_an_audit_of_a_scheme_has_the_least_number_of_levels(self):
        """Levels of refinement, by the number of steps that the scheme is asked for."""
        line = saltus.HybridSystem(states={"m": ["x"]}, flow={"m": lambda x: [-x[0]]})
        problem = saltus.HybridProblem(line, mode="m", initial=[1.0], duration=1.0, costs=[saltus.terminal([0])])
        finest = []
        for limit in (0, 1e-9):
            lengths = []
            saltus.audit(problem, step=lambda x, h: ("m", lengths.append(h) or x - h * x), steps=10, audit_seconds=limit)
            finest.append(min(lengths))
        assert finest[1] > finest[0] * 1.5
        with pytest.raises(ValueError, match="audit_seconds: expected seconds, or 0 for no limit"):
            saltus.audit(problem, step=lambda x, h: ("m", x), audit_seconds=-1)

    def test_an_audit_has_the_models_that_were_judged(self, two_balls):
        def simulate(scene, initial, control, dt):
            time.sleep(seconds)  # the limit is reached in the first call
            return initial

        def judged(seconds):
            return saltus.audit(two_balls, "toi_velocity", simulate=simulate, seconds=seconds, threads=1)

        seconds = 0.25
        while (audit := judged(seconds)).verdicts.get("toi_velocity", "interrupted") == "interrupted" and seconds < 60:
            seconds *= 2  # the first model takes longer on this machine
        assert audit["interrupted"] and f"the limit of {seconds:g} s was reached" in audit["reason"] and "interrupted" in repr(audit)
        assert audit.of("toi_velocity").to_dict() == saltus.audit(two_balls, "toi_velocity").of("toi_velocity").to_dict()
        with pytest.raises(saltus.WrongGradient, match="interrupted"):
            audit.raise_if_wrong()
        assert "interrupted" not in saltus.audit(two_balls, "toi_velocity", seconds=1000)
        line = saltus.HybridSystem(states={"m": ["x"]}, flow={"m": lambda x: [-x[0]]})
        problem = saltus.HybridProblem(line, mode="m", initial=[1.0], duration=1.0, costs=[saltus.terminal([0])])

        def step(x, h):
            time.sleep(0.01)
            return "m", x - h * x

        found = saltus.audit(problem, step=step, steps=100, seconds=0.3)
        assert found.interrupted and found.reason == "the limit of 0.3 s was reached; raise seconds, or go on from what was found"

    def test_noisy_runs_until_then(self):
        ball = saltus.HybridSystem(
            states={"m": ["y", "v"]}, controls=["f"], flow={"m": lambda x, u: [x[1], u[0] - 9.8]},
            guards={"m": {"ground": lambda x: x[0]}}, resets={"m": {"ground": lambda x: ("m", [x[0], -0.7 * x[1]])}})
        problem = saltus.HybridProblem(ball, mode="m", initial=[1, 0], duration=1.0, control=np.zeros((50, 1)))
        samples, seconds = 3_000_000, 0.2  # which take a minute; the first two may take longer than the limit
        while (runs := saltus.noisy_runs(problem, 1e-6 * np.eye(2), samples=samples, seconds=seconds)).counted < 2:
            assert "there is no covariance" in runs.remark
            seconds *= 2
        assert runs.counted < samples and np.isfinite(runs.covariance).all() and runs.final_error < 0.1
        assert f"{runs.counted} of {samples} runs were simulated: the limit of {seconds:g} s was reached" in runs.remark
        one = saltus.noisy_runs(problem, 1e-6 * np.eye(2), samples=1)
        assert one.remark == "there is no covariance: found 1 runs that count, expected at least 2; raise samples"
        assert one.counted == 1 and np.isnan(one.covariance).all() and one.covariance.shape == (2, 2) and np.isnan(one.final_error)
        assert abs(one.mean - saltus.rollout(problem).final).max() < 0.02
        assert saltus.noisy_runs(problem, 1e-6 * np.eye(2), samples=2).remark == ""

    @pytest.mark.parametrize("seconds", [-1, float("inf"), float("nan")])
    def test_what_is_no_time_is_refused(self, two_balls, seconds):
        with pytest.raises(ValueError, match="seconds: found .*, expected a finite number of at least 0; 0 is no limit"):
            saltus.solve(two_balls, "ncp", "gd", seconds=seconds)
        with pytest.raises(TypeError, match="seconds: found str, expected a number"):
            saltus.solve(two_balls, seconds="1")


class TestProgress:
    def test_a_line_shows_iterations_and_goes(self):
        out = io.StringIO()
        with _progress.Progress("solve", True, 20, out, delay=0) as shown:
            shown.callback(None)(5, 1.25)
            shown.status(None)("start 2")
            while "start 2" not in out.getvalue():
                time.sleep(0.01)
        assert "\rsolve: [=====               ] 5/20, 0 s, start 2" in out.getvalue()
        assert out.getvalue().endswith("\r") and not out.getvalue().split("\r")[-2].strip()

    def test_what_is_called_is_called_on(self, two_balls, capsys, monkeypatch):
        seen, answers = [], iter([True, False])
        run = saltus.solve(two_balls, "direct_toi", "gd", progress=True,
                           callback=lambda k, loss: seen.append(k) or next(answers))
        assert seen == [0, 1] and run["termination"] == "interrupted"
        monkeypatch.setattr(_progress, "_DELAY", 0)
        saltus.solve(two_balls, "ncp", "gd", iterations=LONG, seconds=0.5, progress=True)
        assert "/10000000, " in capsys.readouterr().err

    def test_calls_within_others_have_no_line(self):
        out = io.StringIO()
        with _progress.Progress("sweep", True, 2, out, delay=0) as shown, _progress.Progress("solve", True, 9, out, delay=0) as inner:
            assert shown.shown and not inner.shown
            while "sweep" not in out.getvalue():
                time.sleep(0.01)
        assert "solve" not in out.getvalue()
        with _progress.Progress("solve", True, 9, out) as later:
            assert later.shown

    @pytest.mark.parametrize("kind", ["scene", "hybrid"])
    def test_batches_count_their_points(self, two_balls, kind, capsys):
        """More and more points, until they take more than two seconds."""
        if kind == "hybrid":
            line = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], flow={"m": lambda x, u: [x[1], u[0] - x[0] ** 3]})
            problem = saltus.HybridProblem(line, mode="m", initial=[1, 0], duration=10.0, control=np.zeros((10, 1)),
                                           costs=[saltus.terminal([0, 0])])
            make, size = functools.partial(saltus.HybridBatch, problem), 10
        else:
            make, size = functools.partial(saltus.Batch, two_balls, "ncp"), 960
        batch, count, shown = make(progress=True), 1000, ""
        while not shown:
            assert count < LONG
            batch.loss_and_gradient(np.full((count, size), 0.5))
            count, shown = 3 * count, capsys.readouterr().err
        assert shown.startswith("\rbatch: [") and shown.endswith(" \r")
        make(progress=False).loss(np.full((3, size), 0.5))
        assert capsys.readouterr().err == "" and not _progress._line.locked()
        with pytest.raises(TypeError, match="progress: found int, expected True, False or None"):
            make(progress=3)

    def test_a_batch_that_is_shown_has_the_same_bits(self, two_balls):
        """Lanes of points are filled in parts then."""
        scene = two_balls.replace(steps=20)
        points = np.random.default_rng(1).normal(size=(5003, saltus.Batch(scene).num_variables))
        losses, gradients = saltus.Batch(scene, progress=True).loss_and_gradient(points)
        plain = saltus.Batch(scene).loss_and_gradient(points)
        assert np.array_equal(losses, plain[0]) and np.array_equal(gradients, plain[1])

    def test_a_counted_line(self):
        out = io.StringIO()
        with _progress.CountedProgress("batch", True, out=out) as shown:
            assert out.getvalue() == ""
            shown.counter(3.2, 5, 20)
            with _progress.CountedProgress("inner", True, out=out) as inner:
                inner.counter(2.0, 1, 2)
        line = "batch: [=====               ] 5/20, 3 s"
        assert out.getvalue() == f"\r{line}\r{' ' * len(line)}\r"
        assert not _progress._line.locked() and _progress.CountedProgress("batch", False).counter is None

    def test_files_have_no_line_unless_asked_for(self, two_balls):
        assert not _progress.Progress("solve", None, out=io.StringIO()).shown
        with pytest.raises(TypeError, match="progress: found str, expected True, False or None"):
            saltus.solve(two_balls, progress="yes")


def test_ctrl_c_ends_noisy_runs():
    """So many samples would take minutes."""
    ball = {"name": "ball", "radius": 0.05, "mass": 1, "position": [0, 0.8], "velocity": [1.6, 0.3]}
    scene = saltus.Scene(
        name="ball", bodies=[ball], duration=1.0, steps=10, gravity=[0, -9.81], optimize="none", contact={"restitution": 0.5},
        planes=[{"name": "floor", "point": [0, 0], "normal": [0, 1]}], objective={"terminal": []},
    )
    few = time.monotonic()
    saltus.noisy_runs(scene, 1e-6 * np.eye(4), samples=20_000)
    few = time.monotonic() - few
    timer = interrupt_soon()
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        saltus.noisy_runs(scene, 1e-6 * np.eye(4), samples=4_000_000)
    timer.join()
    assert time.monotonic() - begin < 0.5 + 60 * few  # of 200 times as many samples
