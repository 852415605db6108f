"""Random systems whose motions slide along jumps of the flow, by saltus and by a method of its own with scipy.

    PYTHONPATH=build/release/python python3 tests/campaign/random_sliding_systems.py --count=200

x' = A x + b + d sin(t) + sum_i g_i sign(c_i x - h_i - 0.2 sin(w_i t)), with one to three conditions, so that the flow along
several of them is determined. The reference knows for each condition whether the motion is above, below or along it, solves
linear equations for the weights of Filippov's convention, and locates where a condition is met or a weight leaves its range.
A result counts as agreeing if states differ by at most 1e-8, relative to the largest, and derivatives by at most 1e-5 from
differences of the reference; one that differs has to have a remark. The exit code is 1 if one differs in silence.
"""

import argparse
import collections
import sys

import numpy as np
from scipy.integrate import solve_ivp

import saltus


class Ends(Exception):
    """The reference does not go on: events at the same time, or no side to go on in."""


class System:
    def __init__(self, rng):
        self.n, self.k = int(rng.integers(2, 5)), int(rng.integers(1, 4))
        n, k = self.n, min(self.k, self.n)
        self.k = k
        self.A = 0.7 * rng.normal(size=(n, n)) - 0.4 * np.eye(n)
        self.b, self.d = 0.5 * rng.normal(size=n), 0.6 * rng.normal(size=n)
        self.c, self.h, self.w = rng.normal(size=(k, n)), 0.3 * rng.normal(size=k), rng.uniform(0.5, 4, size=k)
        self.g = -0.8 * self.c + 0.4 * rng.normal(size=(k, n))  # most often towards the condition
        self.duration = float(rng.uniform(2, 5))
        self.initial = rng.normal(size=n)

    def numbers(self, t, x, p, sin=np.sin):
        return [sum(self.c[i][j] * x[j] for j in range(self.n)) - self.h[i] - p[0] * sin(self.w[i] * t) for i in range(self.k)]

    def recorded(self):
        def flow(t, x, p):
            signs = [np.sign(number) for number in self.numbers(t, x, p)]
            return [sum(self.A[i][j] * x[j] for j in range(self.n)) + self.b[i] * p[1] + self.d[i] * np.sin(t)
                    + sum(self.g[m][i] * signs[m] for m in range(self.k)) for i in range(self.n)]

        return saltus.HybridSystem(states={"m": [f"x{i}" for i in range(self.n)]}, parameters=["p", "q"], flow={"m": flow},
                                   sliding="filippov")

    # The reference. A side is 1, -1 or, along a condition, 0.
    def signs(self, sides, t, x, p):
        signs = np.array(sides, dtype=float)
        along = [i for i in range(self.k) if sides[i] == 0]
        if along:
            smooth = self.A @ x + self.b * p[1] + self.d * np.sin(t) + self.g.T @ signs
            rates = [self.c[i] @ smooth - p[0] * self.w[i] * np.cos(self.w[i] * t) for i in along]
            signs[along] = np.linalg.solve(self.c[along] @ self.g[along].T, -np.array(rates))
        return signs

    def rate(self, sides, t, x, p):
        return self.A @ x + self.b * p[1] + self.d * np.sin(t) + self.g.T @ self.signs(sides, t, x, p)

    def rates_of_numbers(self, sides, t, x, p):
        return self.c @ self.rate(sides, t, x, p) - p[0] * self.w * np.cos(self.w * t)

    def final(self, x, p):
        t, x = 0.0, np.array(x, dtype=float)
        sides = [int(np.sign(number)) for number in self.numbers(t, x, p)]
        changes = []
        while t < self.duration:
            events = []
            for i in range(self.k):
                if sides[i] != 0:
                    events.append((i, None, lambda t, x, i=i, s=sides[i]: s * self.numbers(t, x, p)[i]))
                else:
                    for end in (1, -1):
                        events.append((i, end, lambda t, x, i=i, e=end, s=tuple(sides): 1 - e * self.signs(s, t, x, p)[i]))
            functions = [lambda t, x, f=f: f(t, x) for _, _, f in events]
            for function in functions:
                function.terminal, function.direction = True, -1
            found = solve_ivp(lambda t, x: self.rate(sides, t, x, p), (t, self.duration), x, method="DOP853", rtol=1e-12, atol=1e-13,
                              max_step=0.05, events=functions)
            # Just behind an event its own number is not looked at: it would be zero again.
            t, x = found.t[-1], found.y[:, -1]
            if found.status != 1:
                break
            hits = [e for e, times in zip(events, found.t_events) if len(times) > 0]
            if len(hits) != 1 or len(changes) > 200:
                raise Ends("two events at the same time, or many")
            i, end, _ = hits[0]
            if end is None:
                other = list(sides)
                other[i] = -sides[i]
                back = sides[i] * self.rates_of_numbers(other, t, x, p)[i]
                if abs(back) < 1e-6:
                    raise Ends("grazes")
                sides[i] = 0 if back > 0 else -sides[i]
            else:
                sides[i] = end
            signs = self.signs(sides, t, x, p)
            if any(sides[j] == 0 and abs(signs[j]) > 1 - 1e-6 for j in range(self.k)):
                raise Ends("another condition is left at the same time")
            changes.append((t, i, sides[i]))
            t, x = self.beyond(sides, t, x, p)
        return x, changes

    def beyond(self, sides, t, x, p):
        """A little later, where the numbers of the sides are not zero."""
        step = min(1e-4, self.duration - t)
        if step <= 0:
            return t, x
        found = solve_ivp(lambda t, x: self.rate(sides, t, x, p), (t, t + step), x, method="DOP853", rtol=1e-12, atol=1e-14)
        return t + step, found.y[:, -1]


def compare(seed):
    """What became of one system, and a text about it."""
    system = System(np.random.default_rng(seed))
    p = np.array([0.2, 1.0])
    try:
        exact, changes = system.final(system.initial, p)
        columns = []
        for i in range(system.n + 2):
            ends = []
            for step in (1e-5, -1e-5):
                x, q = system.initial.copy(), p.copy()
                (x if i < system.n else q)[i if i < system.n else i - system.n] += step
                end, its_changes = system.final(x, q)
                if [c[1:] for c in its_changes] != [c[1:] for c in changes]:
                    raise Ends("other changes nearby")
                ends.append(end)
            columns.append((ends[0] - ends[1]) / 2e-5)
    except Ends as end:
        return "no reference", str(end)
    if not any(side == 0 for _, _, side in changes):
        return "no reference", "it does not slide"
    problem = saltus.HybridProblem(system.recorded(), mode="m", initial=system.initial, parameters=p, duration=system.duration)
    try:
        motion, d = saltus.rollout(problem), saltus.final_derivatives(problem)
    except RuntimeError as error:
        return "refused", str(error)
    by, remark = np.transpose(columns), motion.remark or d.remark
    worst = np.max(np.abs(motion.final - exact)) / max(1.0, np.max(np.abs(exact)))
    differs = np.max(np.abs(np.hstack([d.by_initial, d.by_parameters]) - by)) / max(1.0, np.max(np.abs(by)))
    if worst <= 1e-8 and differs <= 1e-5:
        return ("agrees, with a remark" if remark else "agrees"), remark
    text = f"states {worst:.1e}, derivatives {differs:.1e}, {len(motion.switches)} switches of {len(changes)}, remark {remark!r}"
    return ("differs, with a remark" if remark else "DIFFERS"), text


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first system")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    counts = collections.Counter()
    seed = options.first
    while sum(counts.values()) - counts["no reference"] < options.count:
        kind, text = compare(seed)
        counts[kind] += 1
        if kind == "DIFFERS" or (options.verbose and kind not in ("agrees", "no reference")):
            print(f"{seed}: {kind}: {text}", flush=True)
        seed += 1
    print(", ".join(f"{kind}: {count}" for kind, count in sorted(counts.items())))
    return 1 if counts["DIFFERS"] else 0


if __name__ == "__main__":
    sys.exit(main())
