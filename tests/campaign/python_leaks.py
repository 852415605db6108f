"""Measures by how much the memory of a process grows over many calls of every entry point of the Python module.

Usage, with the module on PYTHONPATH and the folder of scenes in SALTUS_SOURCE:

    python_leaks.py --count=10000 [--only=NAME]
"""

import argparse
import copy
import ctypes
import gc
import os
import pathlib
import pickle
import sys
import tempfile

import numpy as np

import saltus

PROBLEMS = pathlib.Path(os.environ["SALTUS_SOURCE"]) / "problems"
LIBC = ctypes.CDLL(None)


def resident():
    """The resident memory of the process, KiB, without what the allocator keeps for later."""
    gc.collect()
    LIBC.malloc_trim(0)
    return int(pathlib.Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1024


class Drift(saltus.ContactModel):
    name = "drift"

    def step(self, x, u, h):
        x[:, :2] += h * x[:, 2:4]
        return x


def entries():
    """Functions without arguments by name, each a call of one entry point."""
    scene = saltus.load_scene(PROBLEMS / "two_balls.yaml").replace(steps=8)
    simulation, end = saltus.Simulation(scene), saltus.EndState(scene)
    one, two = saltus.Batch(scene, threads=1), saltus.Batch(scene, threads=2)
    points = np.stack([simulation.initial_guess] * 8)
    state = simulation.rollout()["states"][0]
    ball = {
        "states": {"flight": ["y", "v"]}, "controls": ["u"], "flow": {"flight": lambda t, x, u, p: [x[1], u[0] - 9.8]},
        "guards": {"flight": {"ground": lambda t, x, p: x[0]}},
        "resets": {"flight": {"ground": lambda t, x, p: ("flight", [0, -0.7 * x[1]])}}}
    system = saltus.HybridSystem(**ball)
    problem = saltus.HybridProblem(
        system, mode="flight", initial=[1, 0], duration=0.7, control=np.zeros((2, 1)), costs=[saltus.terminal([1, 0])], tolerance=1e-6)
    regulator = saltus.track(problem, np.eye(2), np.eye(1), np.eye(2))
    estimate = saltus.SaltedKalmanFilter(system, [1e6, 0], np.eye(2))
    times = np.linspace(0, 0.6, 8)
    recording = {"time": times, "body": np.zeros(8, dtype=int), "position": np.stack([times, 1 + 0 * times], 1), "sigma": np.full(8, 0.01)}
    path = os.path.join(tempfile.gettempdir(), f"saltus_leaks_{os.getpid()}.json")

    def refused(call, *arguments):
        try:
            call(*arguments)
        except (ValueError, TypeError, RuntimeError):
            return
        raise AssertionError("expected an error")

    def filtered():
        estimate.predict(estimate.time + 1e-3, process=1e-9 * np.eye(2))
        estimate.update([estimate.mean[0]], [[1, 0]], [[1.0]])
        return estimate.covariance

    def saved():
        saltus.rollout(scene).save(path)
        return saltus.load_result(path)

    return {
        "Scene": lambda: saltus.Scene(scene.to_dict()), "load_scene": lambda: saltus.load_scene(PROBLEMS / "two_balls.yaml"),
        "rollout": lambda: saltus.rollout(scene), "loss_and_gradient": lambda: saltus.loss_and_gradient(scene),
        "linearize": lambda: saltus.linearize(scene), "Simulation": lambda: saltus.Simulation(scene),
        "Simulation.loss": simulation.loss, "Simulation.loss_and_gradient": simulation.loss_and_gradient,
        "Simulation.residuals": simulation.residuals, "Simulation.rollout": simulation.rollout,
        "Simulation.step": lambda: simulation.step(state), "Simulation.linearize": lambda: simulation.linearize(state),
        "Batch": lambda: saltus.Batch(scene, threads=2), "Batch.loss": lambda: one.loss(points),
        "Batch.loss of two threads": lambda: two.loss(points),
        "Batch.loss_and_gradient of two threads": lambda: two.loss_and_gradient(points),
        "EndState": lambda: end(end.initial, end.control), "EndState.vjp": lambda: end.vjp(end.initial, end.control, end.initial),
        "a contact model in Python": lambda: saltus.loss_and_gradient(scene, Drift),
        "solve": lambda: saltus.solve(scene, "event", "gd", iterations=1),
        "audit": lambda: saltus.audit(scene, simulate=lambda scene, initial, control, dt: initial),
        "identify": lambda: saltus.identify(scene, recording, "restitution", starts=1, threads=2),
        "HybridSystem": lambda: saltus.HybridSystem(**ball), "hybrid rollout": lambda: saltus.rollout(problem),
        "hybrid loss_and_gradient": lambda: saltus.loss_and_gradient(problem),
        "final_derivatives": lambda: saltus.final_derivatives(problem),
        "hybrid solve": lambda: saltus.solve(problem, solver="gd", iterations=1), "copies": lambda: copy.deepcopy(copy.copy(problem)),
        "pickles": lambda: pickle.loads(pickle.dumps([problem, simulation, estimate])),
        "track": lambda: saltus.track(problem, np.eye(2), np.eye(1), np.eye(2)),
        "propagate": lambda: saltus.propagate(problem, np.eye(2), regulator=regulator),
        "noisy_runs": lambda: saltus.noisy_runs(problem, 1e-4 * np.eye(2), regulator=regulator, samples=4, threads=2),
        "SaltedKalmanFilter": filtered, "save": saved, "contact_models": saltus.contact_models, "solvers": saltus.solvers,
        "an error": lambda: refused(simulation.loss, np.zeros(3)),
        "an error of a filter": lambda: refused(estimate.update, [np.nan], [[1, 0]], [[1.0]]),
        "an error in a recorded function": lambda: refused(
            lambda: saltus.HybridSystem(**{**ball, "flow": {"flight": lambda t, x, u, p: [x[7], 1 / 0]}})),
    }


def growth(call, count):
    """KiB by which the memory grows over `count` calls, after a quarter as many."""
    for _ in range(count // 4 + 10):
        call()
    before = resident()
    for _ in range(count):
        call()
    return resident() - before


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=10000)
    parser.add_argument("--slow", type=int, default=0, help="calls of audit, which take long; default: a fiftieth")
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    worst = 0.0
    for name, call in entries().items():
        if options.only and name != options.only:
            continue
        count = options.slow or max(options.count // 50, 5) if name == "audit" else options.count
        grown = growth(call, count)
        worst = max(worst, 1024 * grown / count)
        print(f"{name}: {grown:.0f} KiB over {count} calls, {1024 * grown / count:.1f} bytes a call", flush=True)
    print(f"largest: {worst:.1f} bytes a call")
    return 0 if worst < 200 else 1


if __name__ == "__main__":
    sys.exit(main())
