"""Random hybrid systems with jumps and kinks of the flow, simulated and differentiated by saltus and by a method of its own.

    PYTHONPATH=build/release/python python3 tests/campaign/random_switched_systems.py --count=1000

Modes, sizes, guards with time, parameters and carriers, resets between modes of other sizes, controls, and conditions by
where, abs, sign, maximum, floor and %. The reference integrates the state and its derivatives with each condition held
(Gragg, Bulirsch and Stoer's extrapolation), locates zeros of conditions and guards by Newton's method, and takes
saltation matrices in closed form. A result counts as agreeing if states and times differ by at most 1e-9 and derivatives
by at most 1e-7, relative to the largest number of their kind; one that differs has to have a remark. The exit code is 1
if one differs in silence.
"""

import argparse
import collections
import math
import sys

import numpy as np

import saltus

STEP = 1e-30  # of derivatives by complex numbers


class Ends(Exception):
    """The reference does not go on: events at the same time, a motion along a switch, too many events."""


# ---------------------------------------------------------------------------------------------------------------------
# Systems. A condition is a number c(t, x, p), whose side s (a sign or an integer part) chooses a piece of the flow.

class System:
    def __init__(self, rng):
        self.rng = rng
        self.m, self.P = int(rng.integers(0, 2)), int(rng.integers(1, 4))
        self.sizes = [int(rng.integers(1, 5)) for _ in range(rng.integers(1, 4))]
        self.duration = float(rng.uniform(0.5, 2.0))
        self.K = int(rng.integers(1, 4)) if self.m else 1
        self.control = rng.normal(size=(self.K, self.m)) if self.m else None
        self.p = rng.uniform(0.3, 1.2, size=self.P)
        self.mode = int(rng.integers(len(self.sizes)))
        self.initial = rng.normal(size=self.sizes[self.mode])
        self.modes = [self._mode(n) for n in self.sizes]

    def _number(self, n):
        """c(t, x, p), and the shortest time in which it changes."""
        rng, kind = self.rng, self.rng.integers(4)
        a, i, j = rng.normal(size=n), int(rng.integers(n)), int(rng.integers(self.P))
        if kind == 0:
            return lambda t, x, p: sum(a[k] * x[k] for k in range(n)) - 0.3 * p[j], 1.0
        if kind == 1:
            return lambda t, x, p: x[i] - 0.4 * p[j], 1.0
        if kind == 2:
            w, phase = float(np.exp(rng.uniform(math.log(2), math.log(150)))), rng.uniform(0, 6)
            return lambda t, x, p: np.sin(w * t + phase) - 0.6 * p[j] + 0.1 * x[i], 1 / w
        w = float(rng.uniform(2, 20))
        return lambda t, x, p: x[i] - 0.5 * np.cos(w * t) - 0.2 * p[j], 1 / w

    def _condition(self, n):
        rng = self.rng
        number, fast = self._number(n)
        kind = ("where", "abs", "drag", "maximum", "sign", "floor", "remainder")[int(rng.integers(7))]
        size, row = float(rng.uniform(0.2, 1.5)), int(rng.integers(n))
        j = int(rng.integers(self.P))
        if kind == "floor":
            scale = float(rng.uniform(0.2, 0.6))
            return {"number": lambda t, x, p: number(t, x, p) / scale, "fast": fast, "floor": True, "row": row,
                    "held": lambda c, s, p: size * 0.3 * s, "recorded": lambda c, p: size * 0.3 * np.floor(c)}
        if kind == "remainder":
            period = float(rng.uniform(0.05, 0.5))
            return {"number": lambda t, x, p: (t + 0.01 * p[j]) / period, "fast": period, "floor": True, "row": row,
                    "held": lambda c, s, p: size * (c - s), "recorded": lambda c, p: size * (c % 1.0)}
        forms = {
            "where": (lambda c, s, p: size * p[j] * (1.0 if s > 0 else -0.4), lambda c, p: saltus.where(c > 0, size * p[j], -0.4 * size * p[j])),
            "abs": (lambda c, s, p: size * c * s, lambda c, p: size * abs(c)),
            "drag": (lambda c, s, p: -size * c * c * s, lambda c, p: -size * c * abs(c)),
            "maximum": (lambda c, s, p: size * c * (1.0 if s > 0 else 0.0), lambda c, p: size * np.maximum(c, 0)),
            "sign": (lambda c, s, p: size * s, lambda c, p: size * np.sign(c)),
        }
        return {"number": number, "fast": fast, "floor": False, "row": row, "held": forms[kind][0], "recorded": forms[kind][1]}

    def _mode(self, n):
        rng, P, m = self.rng, self.P, self.m
        A, b = 0.8 * rng.normal(size=(n, n)) - 0.3 * np.eye(n), rng.normal(size=n)
        c, B = 0.3 * rng.normal(size=n), rng.normal(size=(n, max(m, 1)))
        which = rng.integers(P, size=n)
        conditions = [self._condition(n) for _ in range(rng.integers(0, 3))]
        guards = []
        for _ in range(rng.integers(0, 3)):
            number, fast = self._number(n)
            other = int(rng.integers(len(self.sizes)))
            size = self.sizes[other]
            R, r, w = 0.6 * rng.normal(size=(size, n)), 0.5 * rng.normal(size=size), int(rng.integers(P))
            guards.append({
                "number": lambda t, x, p, g=number: g(t, x, p) + 0.7, "fast": fast, "next": other,
                "reset": lambda t, x, p, R=R, r=r, w=w, size=size, n=n: [
                    sum(R[i][k] * x[k] for k in range(n)) + r[i] * p[w] + 0.1 * np.sin(t) for i in range(size)]})

        def smooth(t, x, u, p):
            return [sum(A[i][k] * x[k] for k in range(n)) + b[i] * p[which[i]] + c[i] * np.sin(x[(i + 1) % n] + t)
                    + sum(B[i][k] * u[k] for k in range(m)) for i in range(n)]

        return {"n": n, "smooth": smooth, "conditions": conditions, "guards": guards}

    def recorded(self):
        def flow(mode):
            def f(t, x, u, p):
                rate = mode["smooth"](t, x, u, p)
                for condition in mode["conditions"]:
                    rate[condition["row"]] = rate[condition["row"]] + condition["recorded"](condition["number"](t, x, p), p)
                return rate
            return f

        names = [f"m{i}" for i in range(len(self.sizes))]
        return saltus.HybridSystem(
            states={name: [f"x{i}" for i in range(n)] for name, n in zip(names, self.sizes)},
            controls=[f"u{i}" for i in range(self.m)], parameters=[f"p{i}" for i in range(self.P)],
            flow={name: flow(mode) for name, mode in zip(names, self.modes)},
            guards={name: {f"g{i}": g["number"] for i, g in enumerate(mode["guards"])} for name, mode in zip(names, self.modes)},
            resets={name: {f"g{i}": (lambda t, x, p, g=g: (f"m{g['next']}", g["reset"](t, x, p)))
                           for i, g in enumerate(mode["guards"])} for name, mode in zip(names, self.modes)})

    def problem(self):
        return saltus.HybridProblem(self.recorded(), mode=f"m{self.mode}", initial=self.initial, parameters=self.p,
                                    duration=self.duration, control=self.control)


# ---------------------------------------------------------------------------------------------------------------------
# The reference: columns of derivatives by [initial control parameters duration].

def extrapolated(f, y, h, tolerance=1e-13):
    """One step of Gragg's method, extrapolated until two diagonal entries agree; None if they do not."""
    rows = []
    f0 = f(0.0, y)
    for level in range(10):
        k = 2 * (level + 1)
        d = h / k
        before, now = y, y + d * f0
        for i in range(1, k):
            before, now = now, before + 2 * d * f(i * d, now)
        end = 0.5 * (now + before + d * f(h, now))
        row = [end]
        for j in range(level):
            ratio = (k / (2 * (level - j))) ** 2
            row.append(row[j] + (row[j] - rows[-1][j]) / (ratio - 1))
        if level > 2 and np.max(np.abs(row[-1] - rows[-1][-1])) <= tolerance * (1 + np.max(np.abs(row[-1]))):
            return row[-1]
        rows.append(row)
    return None


class Reference:
    """part: of the shortest time in which a number changes, the length of a step. Two zeros of a number within a step are
    not seen."""

    def __init__(self, system, part):
        self.s, n0, self.part = system, len(system.initial), part
        self.control = system.control if system.m else np.zeros((system.K, 0))
        self.columns = n0 + system.K * system.m + system.P + 1
        self.events = []
        self.just = None  # the number that the last event left at zero
        self.t, self.mode, self.x = 0.0, system.mode, np.array(system.initial, dtype=float)
        self.S = np.zeros((n0, self.columns))
        self.S[:, :n0] = np.eye(n0)
        self.first_p = n0 + system.K * system.m
        self.interval = 0

    def seeds(self):
        """Parameters and control, with their derivatives in a column each, and none in the first."""
        p = np.tile(self.s.p[:, None].astype(complex), self.columns + 1)
        for i in range(self.s.P):
            p[i, 1 + self.first_p + i] += 1j * STEP
        u = np.tile(self.control[self.interval][:, None].astype(complex), self.columns + 1)
        for i in range(self.s.m):
            u[i, 1 + len(self.s.initial) + self.interval * self.s.m + i] += 1j * STEP
        return p, u

    def stacked(self, y):
        return y[:, :1] + 1j * STEP * np.concatenate([np.zeros((len(y), 1)), y[:, 1:]], axis=1)

    def flow(self, sides, t, y):
        """Of [x S]."""
        mode, (p, u), X = self.s.modes[self.mode], self.fixed, self.stacked(y)
        rate = [value + np.zeros(self.columns + 1, dtype=complex) for value in mode["smooth"](t, X, u, p)]
        for condition, side in zip(mode["conditions"], sides):
            rate[condition["row"]] = rate[condition["row"]] + condition["held"](condition["number"](t, X, p), side, p)
        rate = np.array(rate)
        return np.concatenate([rate[:, :1].real, rate[:, 1:].imag / STEP], axis=1)

    def numbers(self, sides, t, x):
        """Of guards, then of conditions: above zero within the piece. Those of integer parts have two."""
        mode, p = self.s.modes[self.mode], self.s.p
        found = [("guard", i, 0, g["number"](t, x, p)) for i, g in enumerate(mode["guards"])]
        for i, (condition, side) in enumerate(zip(mode["conditions"], sides)):
            c = condition["number"](t, x, p)
            if condition["floor"]:
                found += [("condition", i, -1, c - side), ("condition", i, 1, side + 1 - c)]
            else:
                found.append(("condition", i, -2 * side, side * c))
        return found

    def sides_here(self):
        sides = []
        for condition in self.s.modes[self.mode]["conditions"]:
            c = condition["number"](self.t, self.x, self.s.p)
            near = abs(c - round(c)) if condition["floor"] else abs(c)
            if near < 1e-9:
                raise Ends("begins on a condition")
            sides.append(math.floor(c) if condition["floor"] else (1 if c > 0 else -1))
        return sides

    def enter(self):
        self.sides = self.sides_here()
        for number in self.numbers(self.sides, self.t, self.x):
            if number[0] == "guard" and number[3] < 1e-9:
                raise Ends("a guard is not above zero on entry")

    def advance(self, h):
        y = np.concatenate([self.x[:, None], self.S], axis=1)
        return extrapolated(lambda s, z: self.flow(self.sides, self.t + s, z), y, h)

    def run(self):
        s = self.s
        self.fixed = self.seeds()
        self.enter()
        for k in range(s.K):
            self.interval = k
            if k > 0:
                before = self.flow(self.sides, self.t, np.concatenate([self.x[:, None], self.S], axis=1))[:, 0]
                self.fixed = self.seeds()
                after = self.flow(self.sides, self.t, np.concatenate([self.x[:, None], self.S], axis=1))[:, 0]
                self.S[:, -1] += (before - after) * k / s.K
            end = s.duration * (k + 1) / s.K
            while self.t < end:
                self.step(end)
        self.S[:, -1] += self.flow(self.sides, self.t, np.concatenate([self.x[:, None], self.S], axis=1))[:, 0]

    def step(self, end):
        mode = self.s.modes[self.mode]
        fast = min([1.0] + [c["fast"] for c in mode["conditions"] + mode["guards"]])
        h = min(self.part * fast, 0.05, end - self.t)
        if end - self.t - h < 1e-12:
            h = end - self.t
        begin = self.numbers(self.sides, self.t, self.x)
        while True:
            y = self.advance(h)
            if y is not None and np.all(np.isfinite(y)):
                after = self.numbers(self.sides, self.t + h, y[:, 0])
                crossing = [i for i in range(len(begin)) if after[i][3] <= 0]
                if not any(begin[i][:3] == self.just for i in crossing):
                    break
            h /= 2
            if h < 1e-9:
                raise Ends("the flow is too fast, or a condition returns to zero at once")
        if not crossing:
            self.t = end if abs(self.t + h - end) < 1e-12 else self.t + h
            self.x, self.S, self.just = y[:, 0].copy(), y[:, 1:].copy(), None
            return
        located = sorted((self.locate(i, h), i) for i in crossing)
        if len(located) > 1 and located[1][0] - located[0][0] < 1e-8:
            raise Ends("two events at the same time")
        when, i = located[0]
        if end - self.t - when < 1e-8:
            raise Ends("an event where the control jumps, or at the end")
        self.happen(when, begin[i])

    def locate(self, i, h):
        low, high, at = 0.0, h, 0.5 * h
        for _ in range(100):
            y = self.advance(at)
            value = self.numbers(self.sides, self.t + at, y[:, 0])[i][3]
            if value > 0:
                low = at
            else:
                high = at
            w = 1e-6 * h
            z = self.advance(at + w)
            slope = (self.numbers(self.sides, self.t + at + w, z[:, 0])[i][3] - value) / w
            newton = at - value / slope if slope != 0 else -1
            next_at = newton if low < newton < high else 0.5 * (low + high)
            if abs(next_at - at) < 1e-15 * max(1, self.t):
                break
            at = next_at
        return at

    def happen(self, when, which):
        if len(self.events) > 400:
            raise Ends("many events")
        y = self.advance(when)
        self.t += when
        self.x, self.S = y[:, 0].copy(), y[:, 1:].copy()
        mode, (p, _) = self.s.modes[self.mode], self.fixed
        X = self.stacked(y)
        kind, i, by, _ = which
        item = mode["guards" if kind == "guard" else "conditions"][i]
        f = self.flow(self.sides, self.t, y)[:, 0]
        along = item["number"](self.t, X, p)
        c_columns = (along + np.zeros(self.columns + 1)).imag[1:] / STEP
        rate = complex(item["number"](self.t + 1j * STEP, self.x + 1j * STEP * f, self.s.p)).imag / STEP
        if abs(rate) < 1e-6:
            raise Ends("grazes")
        dt = -c_columns / rate
        if kind == "condition":
            self.sides[i] = self.sides[i] + by
            after = self.flow(self.sides, self.t, y)[:, 0]
            rate_after = complex(item["number"](self.t + 1j * STEP, self.x + 1j * STEP * after, self.s.p)).imag / STEP
            if rate_after * rate <= 0:
                raise Ends("a motion along a condition")
            self.S = self.S + np.outer(f - after, dt)
            self.just = ("condition", i, -by)
            return
        self.events.append((self.t, self.mode, i, item["next"]))
        moved = X + 1j * STEP * np.concatenate([np.zeros((len(f), 1)), np.outer(f, dt)], axis=1)
        time = self.t + 1j * STEP * np.concatenate([[0.0], dt])
        reset = np.array([value + np.zeros(self.columns + 1, dtype=complex) for value in item["reset"](time, moved, p)])
        self.mode = item["next"]
        self.x = reset[:, 0].real.copy()
        self.S = reset[:, 1:].imag / STEP
        self.enter()
        self.just = None
        after = self.flow(self.sides, self.t, np.concatenate([self.x[:, None], self.S], axis=1))[:, 0]
        self.S = self.S - np.outer(after, dt)


# ---------------------------------------------------------------------------------------------------------------------

def compare(seed):
    """What became of one system, and a text about it. Where results differ, the reference is computed again with shorter
    steps."""
    kind, text = compare_with(seed, 0.25)
    return compare_with(seed, 0.02) if kind == "DIFFERS" else (kind, text)


def compare_with(seed, part):
    system = System(np.random.default_rng(seed))
    reference = Reference(system, part)
    try:
        with np.errstate(all="ignore"):
            reference.run()
    except Ends as end:
        return "no reference", str(end)
    if not np.all(np.isfinite(reference.S)) or np.max(np.abs(reference.S)) > 1e8:
        return "no reference", "the motion is too sensitive"
    try:
        problem = system.problem()
        motion = saltus.rollout(problem)
        d = saltus.final_derivatives(problem)
    except RuntimeError as error:
        return "refused", str(error)
    remark = motion.remark or d.remark
    found = [(int(mode[1:]), int(guard[1:]), int(after[1:])) for _, mode, guard, after in motion.events]
    worst, by = 0.0, math.inf
    if found == [event[1:] for event in reference.events] and len(motion.final) == len(reference.x):
        times = [abs(a[0] - b[0]) for a, b in zip(motion.events, reference.events)]
        worst = max([np.max(np.abs(motion.final - reference.x)) / max(1.0, np.max(np.abs(reference.x)))] + times)
        found_by = np.concatenate([d.by_initial, d.by_control.reshape(len(motion.final), -1), d.by_parameters,
                                   d.by_duration[:, None]], axis=1)
        by = np.max(np.abs(found_by - reference.S)) / max(1.0, np.max(np.abs(reference.S)))
    else:
        worst = math.inf
    if worst <= 1e-9 and by <= 1e-7:
        return ("agrees, with a remark" if remark else "agrees"), remark
    text = f"states {worst:.1e}, derivatives {by:.1e}, {len(found)} events of {len(reference.events)}, remark {remark!r}"
    return ("differs, with a remark" if remark else "DIFFERS"), text


def missed_comparator(frequency, duty):
    """Whether events of y' = 1 - y while sin(2 pi f t) < d, else -y, over 1 s are missed in silence: closed form."""
    w, a, y, t, on = 2 * math.pi * frequency, math.asin(duty), 0.0, 0.0, 1
    phases = [phase + 2 * math.pi * k for k in range(int(frequency) + 1) for phase in (a, math.pi - a)]
    times = [phase / w for phase in phases if phase < w]
    for v in times + [1.0]:
        y, t, on = on + (y - on) * math.exp(t - v), v, 1 - on
    comparator = saltus.HybridSystem(
        states={"on": ["y"], "off": ["y"]}, parameters=["d"],
        flow={"on": lambda t, x, u, p: [1 - x[0]], "off": lambda t, x, u, p: [-x[0]]},
        guards={"on": {"off": lambda t, x, p: p[0] - np.sin(w * t)}, "off": {"on": lambda t, x, p: np.sin(w * t) - p[0]}},
        resets={"on": {"off": lambda t, x, p: ("off", x)}, "off": {"on": lambda t, x, p: ("on", x)}})
    motion = saltus.rollout(saltus.HybridProblem(comparator, mode="on", initial=[0], parameters=[duty], duration=1.0))
    right = len(motion.events) == len(times) and abs(motion.final[0] - y) < 1e-10
    return not right and not motion.remark


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first system")
    parser.add_argument("--comparators", type=int, default=0, help="guards of 1 to 10000 Hz, with closed forms")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    rng = np.random.default_rng(options.first)
    missed = 0
    for _ in range(options.comparators):
        frequency, duty = 10 ** rng.uniform(0, 4), rng.uniform(0.02, 0.95)
        if rng.uniform() < 0.5:
            frequency = round(frequency)
        if missed_comparator(frequency, duty):
            missed += 1
            print(f"comparator of {frequency} Hz, {duty}: missed events", flush=True)
    if options.comparators:
        print(f"comparators: {options.comparators}, of which {missed} miss events in silence")
    counts = collections.Counter()
    seed = options.first
    while sum(counts.values()) - counts["no reference"] < options.count:
        kind, text = compare(seed)
        counts[kind] += 1
        if kind == "DIFFERS" or (options.verbose and kind != "agrees" and kind != "no reference"):
            print(f"{seed}: {kind}: {text}", flush=True)
        seed += 1
    print(", ".join(f"{kind}: {count}" for kind, count in sorted(counts.items())))
    return 1 if counts["DIFFERS"] or missed else 0


if __name__ == "__main__":
    sys.exit(main())
