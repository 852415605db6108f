"""Random systems whose motions slide along jumps of the flow, by saltus and by an independent method.

    PYTHONPATH=build/release/python python3 tests/campaign/random_sliding_systems.py --count=200

x' = A x + b + d sin(t) + sum_i g_i sign(c_i x - h_i - 0.2 sin(w_i t)), with one to three conditions, so that the flow along
several of them is determined. The reference knows for each condition whether the motion is above, below or along it, solves
linear equations for the weights of Filippov's convention, and locates where a condition is met or a weight leaves its range.
A result counts as agreeing if states differ by at most 1e-8, relative to the largest, and derivatives by at most 1e-5 from
differences of the reference; one that differs has to have a remark. The exit code is 1 if one differs in silence.
"""

import itertools
import pathlib
import sys

import numpy as np

import saltus

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from reference_motions import Ends, arguments, extrapolated, limited, run, step, verdict  # noqa: E402

IMAGINARY = 1e-30  # of derivatives by complex numbers


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
        signs = np.array(sides, dtype=x.dtype)
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

    def ends(self, sides, t, x, p):
        """The numbers whose zeros end the piece: of a condition beside it, and of its weight along it at both ends."""
        slope = self.rate(sides, t, x, p)
        t, x = t + 1j * IMAGINARY, x + 1j * IMAGINARY * slope
        numbers, signs = self.numbers(t, x, p), self.signs(sides, t, x, p)
        found = []
        for i, side in enumerate(sides):
            if side != 0:
                found.append(((i, None), side * numbers[i]))
            else:
                found += [((i, end), 1 - end * signs[i]) for end in (1, -1)]
        return [(name, complex(value).real, complex(value).imag / IMAGINARY) for name, value in found]

    def settled(self, zeros, sides, t, x, p):
        """The only sides, of conditions at zero, on which the motion goes on: away from a condition, or along it."""
        found = []
        for choice in itertools.product((-1, 0, 1), repeat=len(zeros)):
            trial = list(sides)
            for i, side in zip(zeros, choice):
                trial[i] = side
            signs, rates = self.signs(trial, t, x, p), self.rates_of_numbers(trial, t, x, p)
            margin = min(1 - abs(signs[i]) if trial[i] == 0 else trial[i] * rates[i] for i in zeros)
            if abs(margin) < 1e-6:
                raise Ends("grazes")
            if margin > 0:
                found.append(trial)
        if len(found) != 1:
            raise Ends("no sides to go on in, or several")
        return found[0]

    def final(self, x, p):
        t, x = 0.0, np.array(x, dtype=float)
        sides = [int(np.sign(number)) for number in self.numbers(t, x, p)]
        changes, just = [], []
        while t < self.duration:
            advance = lambda s: extrapolated(lambda r, y: self.rate(sides, t + r, y, p), x, s)  # noqa: B023, E731
            h = min(0.05, self.duration - t)
            when, y, which = step(advance, lambda s, y: self.ends(sides, t + s, y, p), x, h, just)  # noqa: B023
            t, x, just = (self.duration if abs(t + when - self.duration) < 1e-12 else t + when), y, []
            if which is None:
                continue
            if len(changes) > 200:
                raise Ends("many events")
            i, end = which
            before = list(sides)
            if end is None:
                zeros = [i] + [j for j in range(self.k) if sides[j] == 0]
                sides = self.settled(zeros, sides, t, x, p)
            else:
                zeros, sides[i] = [i], end
            changes += [(t, j, sides[j]) for j in zeros if sides[j] != before[j]]
            just = [(j, None) for j in zeros if sides[j] != 0]
        return x, changes


def compare(seed, seconds=0):
    """What became of one system, and a text about it."""
    system = System(np.random.default_rng(seed))
    p = np.array([0.2, 1.0])
    try:
        with limited(seconds):
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
    return verdict(worst, differs, 1e-8, 1e-5, remark, f"{len(motion.switches)} switches of {len(changes)}")


def main():
    return 0 if run(compare, arguments(200).parse_args()) else 1


if __name__ == "__main__":
    sys.exit(main())
