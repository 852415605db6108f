#!/usr/bin/python3
"""usage: python/bench/cost.py GRADIENT_COST [contact...]

What the gradient of task 3 costs from Python, beside C++ (the program bench/gradient_cost.cc): one call into arrays that
are there, a batch of 10 000, and memory over 10^6 calls; and what that of the SLIP hopper costs, whose functions are recorded
in Python, and 10 000 bouncing balls in one call of a HybridBatch. Least times of several rounds, C++ and Python in turns; times of
calls are CPU times of the thread, so that a busy machine disturbs little.
"""

import json
import math
import resource
import subprocess
import sys
import time

import numpy as np

import saltus

ROUNDS, POINTS, CALLS, REPEATS = 3, 10_000, 2000, 5
WARM, MILLION = 20_000, 1_000_000


def least(measure, repeats=REPEATS):
    return min(measure() for _ in range(repeats))


def call_time(scene, contact):
    """us of one loss_and_gradient."""
    simulation = saltus.Simulation(scene, contact)
    z, out = simulation.initial_guess, np.empty(simulation.shape)

    def measure():
        start = time.thread_time()
        for _ in range(CALLS):
            simulation.loss_and_gradient(z, out)
        return 1e6 * (time.thread_time() - start) / CALLS

    return least(measure)


def batch_time(scene, contact, threads, now):
    """us of each gradient of a batch, into arrays that are there."""
    batch = saltus.Batch(scene, contact, threads=threads)
    points = np.tile(saltus.Simulation(scene, contact).initial_guess.ravel(), (POINTS, 1))
    losses, gradients = np.empty(POINTS), np.empty_like(points)

    def measure():
        start = now()
        batch.loss_and_gradient(points, losses, gradients)
        return 1e6 * (now() - start) / POINTS

    return least(measure, 3)


def hopper_problem():
    """That of problems/hybrid/slip_hopper.h, m = l0 = 1, g = 10."""

    def spring(x, k):
        return k * (1 / math.sqrt(x[0] ** 2 + x[1] ** 2) - 1)

    def flight(t, x, u, p):
        return [x[2], x[3], 0, -10]

    hopper = saltus.HybridSystem(
        states={"down": ["x", "y", "vx", "vy"], "stance": ["xr", "y", "vx", "vy", "xf"], "up": ["x", "y", "vx", "vy"]},
        parameters=["k", "theta"],
        flow={"down": flight, "up": flight,
              "stance": lambda t, x, u, p: [x[2], x[3], spring(x, p[0]) * x[0], spring(x, p[0]) * x[1] - 10, 0]},
        guards={"down": {"touch-down": lambda t, x, p: x[1] - math.cos(p[1])},
                "stance": {"lift-off": lambda t, x, p: 1 - x[0] ** 2 - x[1] ** 2},
                "up": {"apex": lambda t, x, p: x[3]}},
        resets={"down": {"touch-down": lambda t, x, p: (
                    "stance", [-math.sin(p[1]), math.cos(p[1]), x[2], x[3], x[0] + math.sin(p[1])])},
                "stance": {"lift-off": lambda t, x, p: ("up", [x[0] + x[4], *x[1:4]])},
                "up": {"apex": lambda t, x, p: ("down", x)}})
    return saltus.HybridProblem(
        hopper, mode="down", initial=[0, 1.18, 1.02, -0.1], parameters=[100.5, math.radians(10.05)], duration=2.1,
        costs=[saltus.terminal([0.1434523421370905, 0.8489130552112413, None, None, None], mode="stance")])


def hopper_time():
    """us of one loss_and_gradient of the hopper."""
    problem = hopper_problem()
    saltus.loss_and_gradient(problem)

    def measure():
        start = time.thread_time()
        for _ in range(CALLS // 10):
            saltus.loss_and_gradient(problem)
        return 1e7 * (time.thread_time() - start) / CALLS

    return least(measure)


def balls_time(threads):
    """us by the clock of each loss and gradient of bouncing balls in a HybridBatch, whose heights and restitutions differ.

    The system is BouncingBallProblem() of problems/hybrid/bouncing_ball.h.
    """
    ball = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["f"], parameters=["g", "e"],
        flow={"flight": lambda x, u, p: [x[1], u[0] - p[0]]}, guards={"flight": {"ground": lambda x: x[0]}},
        resets={"flight": {"ground": lambda x, p: ("flight", [0, -p[1] * x[1]])}})
    problem = saltus.HybridProblem(ball, mode="flight", initial=[50, 0], parameters=[9.8, 0.98], duration=15,
                                   costs=[saltus.terminal([20.0, None])])
    batch = saltus.HybridBatch(problem, optimize=["y", "e"], threads=threads)
    part = np.arange(POINTS) / POINTS
    points = np.stack([50 + 10 * part, 0.8 + 0.15 * part], axis=1)

    def measure():
        start = time.perf_counter()
        batch.loss_and_gradient(points)
        return 1e6 * (time.perf_counter() - start) / POINTS

    return least(measure, 3)


def growth(scene, contact):
    """Bytes of memory that each of a million calls leaves."""
    simulation = saltus.Simulation(scene, contact)
    z, out = simulation.initial_guess, np.empty(simulation.shape)
    for _ in range(WARM):
        simulation.loss_and_gradient(z, out)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(MILLION):
        simulation.loss_and_gradient(z, out)
    return 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / MILLION


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program, contacts = sys.argv[1], sys.argv[2:] or ["direct_toi", "event"]
    scene = saltus.load_scene("problems/two_balls.yaml")
    for contact in contacts:
        cpp, python = [], []
        for _ in range(ROUNDS):
            done = subprocess.run([program, contact, str(POINTS)], capture_output=True, text=True, check=True)
            cpp.append(json.loads(done.stdout))
            batches = [batch_time(scene, contact, 1 + i, time.perf_counter) for i in range(len(cpp[-1]["batch"]))]
            balls = [balls_time(1 + i) for i in range(len(cpp[-1]["balls"]))]
            python.append({"hopper": hopper_time(), "call": call_time(scene, contact), "batch": batches, "balls": balls,
                           "batch_cpu": batch_time(scene, contact, 1, time.thread_time)})
        best = {key: [min(run[key] for run in runs) for runs in (cpp, python)] for key in ("hopper", "call", "batch_cpu")}
        there, here = best["hopper"]
        print(f"the SLIP hopper: a gradient takes {there:.1f} us in C++, {here:.1f} us from Python: {100 * there / here:.0f} % of "
              "the throughput")
        there, here = best["call"]
        print(f"{contact}: a call takes {there:.2f} us in C++, {here:.2f} us from Python: {here - there:+.2f} us")
        there, here = best["batch_cpu"]
        print(f"{contact}: of a batch of {POINTS}, one thread's CPU: {there:.2f} us in C++, {here:.2f} us from Python: "
              f"{100 * there / here:.1f} % of the throughput")
        for key, name in {"batch": contact, "balls": "bouncing balls"}.items():
            for i in range(len(cpp[0][key])):
                there, here = (min(run[key][i] for run in runs) for runs in (cpp, python))
                print(f"{name}: {i + 1} threads, by the clock: {1e6 / there:.0f} a second in C++, {1e6 / here:.0f} from "
                      f"Python: {100 * there / here:.1f} %")
        print(f"{contact}: a million calls leave {growth(scene, contact):.3f} bytes each", flush=True)


if __name__ == "__main__":
    main()
