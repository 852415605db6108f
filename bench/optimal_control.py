"""Times of ceres_phases and auto beside those of ipopt on the same transcription, for optimal control problems without events.

    PYTHONPATH=build/release/python python3 bench/optimal_control.py [--repeat=3] [--intervals=40]

Runs are paired: the solvers take turns, and each ratio is that of the medians over the repetitions. A run that has not
converged is left out of the ratios and is listed.
"""

import argparse
import time

import numpy as np

import saltus


def system(names, controls, flow):
    return saltus.HybridSystem(states={"m": names}, controls=controls, flow={"m": flow})


def mechanics(size):
    """A chain of masses and springs that harden, with a force on the first."""

    def flow(t, x, u, p):
        q, v = x[:size], x[size:]
        rates = []
        for i in range(size):
            force = (u[0] if i == 0 else 0) - 0.1 * v[i]
            for j in (i - 1, i + 1):
                if 0 <= j < size:
                    d = q[j] - q[i]
                    force = force + 2 * d + 0.1 * d**3
            rates.append(force)
        return [*v, *rates]

    names = [f"q{i}" for i in range(size)] + [f"v{i}" for i in range(size)]
    return system(names, ["u"], flow), 5.0, np.zeros(2 * size), [1.0] * size + [0.0] * size


def pendulum():
    flow = lambda t, x, u, p: [x[1], np.sin(x[0]) + u[0]]
    return system(["angle", "rate"], ["u"], flow), 3.0, np.array([np.pi, 0.0]), [0.0, 0.0]


def cart_pole():
    def flow(t, x, u, p):
        s, c = np.sin(x[1]), np.cos(x[1])
        below = 1.0 + 0.3 * s**2
        force = u[0] + 0.3 * s * (0.5 * x[3] ** 2 + 9.81 * c)
        turn = -(u[0] * c + 0.15 * x[3] ** 2 * s * c + 1.3 * 9.81 * s) / 0.5
        return [x[2], x[3], force / below, turn / below]

    return system(["x", "angle", "v", "rate"], ["u"], flow), 2.0, np.zeros(4), [0.5, np.pi, 0.0, 0.0]


def double_integrator():
    return system(["x", "v"], ["u"], lambda t, x, u, p: [x[1], u[0]]), 1.0, np.array([1.0, 0.0]), [0.0, 0.0]


def van_der_pol():
    flow = lambda t, x, u, p: [(1 - x[1] ** 2) * x[0] - x[1] + u[0], x[0]]
    return system(["x1", "x2"], ["u"], flow), 5.0, np.array([0.0, 1.0]), [0.0, 0.0]


SYSTEMS = {
    "double integrator": double_integrator,
    "pendulum": pendulum,
    "cart and pole": cart_pole,
    "oscillator": van_der_pol,
    "chain of 4": lambda: mechanics(4),
    "chain of 8": lambda: mechanics(8),
}


def problems(intervals):
    """Name, whether all is squares, problem, options of solve."""
    for name, make in SYSTEMS.items():
        s, duration, initial, target = make()
        for kind in ("squares", "tracking", "equalities", "bounds", "free duration"):
            problem = saltus.HybridProblem(s, mode="m", initial=initial, duration=duration,
                                           control=np.full((intervals, 1), 0.1))
            squares = saltus.terminal(target, weight=100.0)
            ends = saltus.residuals(lambda x, target=target: [x[i] - target[i] for i in range(len(target))], role="equality")
            options = {"optimize": ["control"]}
            problem.costs = [saltus.effort(1.0), squares]
            if kind == "tracking":
                problem.costs.append(
                    saltus.residuals(lambda x, target=target: [0.3 * (x[i] - target[i]) for i in range(len(target))], at="steps"))
            elif kind == "equalities":
                problem.costs = [saltus.effort(1.0), ends]
            elif kind == "bounds":
                options["bounds"] = {"u": (-4, 4)}
            elif kind == "free duration":
                problem.costs = [saltus.effort(1.0), squares, saltus.final_time(1.0)]
                options = {"optimize": ["control", "duration"], "bounds": {"duration": (0.3 * duration, 3 * duration)}}
            yield f"{name}, {kind}", kind in ("squares", "tracking"), problem, options


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--intervals", type=int, default=40)
    arguments = parser.parse_args()
    solvers = ("ceres_phases", "auto", "ipopt")
    ratios = {"ceres_phases": [], "auto": []}
    print(f"{'problem':34s}" + "".join(f"{solver + ', s':>20s}" for solver in solvers))
    for name, squares, problem, options in problems(arguments.intervals):
        times = {solver: [] for solver in solvers}
        ends = {}
        for _ in range(arguments.repeat):
            for solver in solvers:
                begin = time.perf_counter()
                ends[solver] = saltus.solve(problem, solver=solver, iterations=1000, **options).termination
                times[solver].append(time.perf_counter() - begin)
        median = {solver: float(np.median(times[solver])) for solver in solvers}
        words = [f"{median[s]:20.3f}" if ends[s] == "converged" else f"{ends[s]:>20s}" for s in solvers]
        print(f"{name:34s}" + "".join(words), flush=True)
        if ends["ipopt"] != "converged":
            continue
        if squares and ends["ceres_phases"] == "converged":
            ratios["ceres_phases"].append(median["ceres_phases"] / median["ipopt"])
        if ends["auto"] == "converged":
            ratios["auto"].append(median["auto"] / median["ipopt"])
    print(f"median of ceres_phases / ipopt over {len(ratios['ceres_phases'])} problems of squares: "
          f"{np.median(ratios['ceres_phases']):.2f}")
    print(f"median of auto / ipopt over all {len(ratios['auto'])} problems: {np.median(ratios['auto']):.2f}")


if __name__ == "__main__":
    main()
