"""Random smooth optimal control problems, solved by `auto` and by `ipopt` alone.

    PYTHONPATH=build/release/python python3 tests/campaign/random_smooth_problems.py --count=200

3 to 10 states, 1 to 3 controls with bounds, terminal equalities, path inequalities on a state, costs that are squares or
values, fixed or free duration. Each problem has a motion that meets its constraints: targets and bounds are those of a
motion under a random control, with a margin. The guess is the control 0. A problem counts as solved if the run has
converged with a stationary certificate. Prints how many each solver has solved, which alone, and the median of the ratio
of times. The exit code is 1 if `auto` solves less than 97 % of what `ipopt` solves.
"""

import argparse
import sys
import time

import numpy as np

import saltus

INTERVALS = 20


def flow_of(rng, n, m):
    """A damped linear system with products, sines and a control of rank m."""
    a = rng.normal(size=(n, n)) * 0.5 / np.sqrt(n) - 0.3 * np.eye(n)
    b = rng.normal(size=(n, m))
    c, w = 0.3 * rng.normal(size=n), rng.uniform(0.5, 2, size=n)
    pairs = rng.integers(0, n, size=(n, 2))

    def flow(t, x, u, p):
        rates = []
        for i in range(n):
            rate = sum(a[i, j] * x[j] for j in range(n)) + sum(b[i, j] * u[j] for j in range(m))
            rate = rate + c[i] * (np.sin(w[i] * x[pairs[i, 0]]) if i % 2 else x[pairs[i, 0]] * x[pairs[i, 1]] / (1 + x[i] ** 2))
            rates.append(rate)
        return rates

    return flow


def problem_of(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(3, 11)), int(rng.integers(1, 4))
    system = saltus.HybridSystem(
        states={"m": [f"x{i}" for i in range(n)]}, controls=[f"u{i}" for i in range(m)], flow={"m": flow_of(rng, n, m)}
    )
    duration = float(rng.uniform(1, 3))
    most = rng.uniform(0.5, 3, size=m)
    place = (np.arange(INTERVALS) + 0.5) / INTERVALS
    control = np.stack([0.8 * most[j] * np.sin(rng.uniform(1, 5) * place + rng.uniform(0, 6)) for j in range(m)], axis=1)
    problem = saltus.HybridProblem(system, mode="m", initial=rng.normal(size=n), duration=duration, control=control)
    steps = [problem.initial]
    for k in range(1, INTERVALS + 1):
        part = saltus.HybridProblem(
            system, mode="m", initial=steps[-1], duration=duration / INTERVALS, control=control[k - 1 : k]
        )
        steps.append(saltus.rollout(part).final)
    end, path = steps[-1], np.array(steps[:-1])

    held = sorted(rng.choice(n, size=int(rng.integers(0, min(n, 2 * m) + 1)), replace=False).tolist())
    costs = [saltus.effort(float(rng.uniform(0.1, 1)))]
    if held:
        costs.append(saltus.residuals(lambda x: [x[i] - end[i] for i in held], role="equality"))
    if rng.uniform() < 0.6:
        i = int(rng.integers(n))
        top = float(max(path[:, i].max(), problem.initial[i]) + 0.05 * np.ptp(path[:, i]) + 1e-3)
        costs.append(saltus.residuals(lambda x: [x[i] - top], role="inequality", at="steps"))
    free = [i for i in range(n) if i not in held]
    if free and rng.uniform() < 0.5:
        j = free[int(rng.integers(len(free)))]
        costs.append(saltus.cost(lambda x: np.sqrt(1 + x[j] ** 2)))
    elif free:
        target = rng.normal(size=n)
        costs.append(saltus.residuals(lambda x: [x[i] - target[i] for i in free]))
    options = {"optimize": ["control"], "bounds": {f"u{j}": (-most[j], most[j]) for j in range(m)}}
    if rng.uniform() < 0.3:
        costs.append(saltus.final_time(float(rng.uniform(0.1, 1))))
        options["optimize"].append("duration")
        options["bounds"]["duration"] = (0.5 * duration, 2 * duration)
    problem.costs = costs
    problem.control = np.zeros_like(control)
    return problem, options


def solve(seed, solver):
    problem, options = problem_of(seed)
    begin = time.perf_counter()
    run = saltus.solve(problem, solver=solver, iterations=1000, **options)
    seconds = time.perf_counter() - begin
    certificate = run.certificate or {}
    solved = run.termination == "converged" and str(certificate.get("verdict", "")).startswith("stationary")
    return solved, run, seconds


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    solved = {"auto": 0, "ipopt": 0}
    both, alone, ratios, worse = 0, {"auto": [], "ipopt": []}, [], []
    for seed in range(arguments.first, arguments.first + arguments.count):
        found = {solver: solve(seed, solver) for solver in solved}
        for solver in solved:
            solved[solver] += found[solver][0]
        ok = {solver: found[solver][0] for solver in solved}
        both += ok["auto"] and ok["ipopt"]
        for one, other in (("auto", "ipopt"), ("ipopt", "auto")):
            if ok[one] and not ok[other]:
                alone[one].append(seed)
        if ok["auto"] and ok["ipopt"]:
            ratios.append(found["auto"][2] / found["ipopt"][2])
            losses = [found[solver][1].loss for solver in ("auto", "ipopt")]
            if losses[0] > losses[1] + 1e-6 * abs(losses[1]):
                worse.append(seed)
        if arguments.verbose or not ok["auto"]:
            for solver in solved:
                run = found[solver][1]
                print(f"{seed} {solver}: {run.termination}, {run.loss:.9g}, {run.iterations} iterations, "
                      f"{found[solver][2]:.2f} s, {run.reason[:160]}", flush=True)
    print(f"of {arguments.count} problems auto has solved {solved['auto']}, ipopt {solved['ipopt']}, both {both}")
    print(f"only auto: {alone['auto']}; only ipopt: {alone['ipopt']}; a worse optimum by auto: {worse}")
    if ratios:
        print(f"median of the times of auto over those of ipopt: {np.median(ratios):.2f}")
    sys.exit(both < 0.97 * solved["ipopt"])


if __name__ == "__main__":
    main()
