"""Random hybrid systems with jumps and kinks of the flow, simulated and differentiated by saltus and by an independent method.

    PYTHONPATH=build/release/python python3 tests/campaign/random_switched_systems.py --count=1000

Modes, sizes, guards with time, parameters and carriers, resets between modes of other sizes, controls, and conditions by
where, abs, sign, maximum, floor and %. Resets may lead behind other guards. The reference integrates the state and its derivatives with each condition held
(Gragg, Bulirsch and Stoer's extrapolation), locates zeros of conditions and guards by Newton's method, and takes
saltation matrices in closed form. A result counts as agreeing if states and times differ by at most 1e-9 and derivatives
by at most 1e-7, relative to the largest number of their kind; one that differs has to have a remark. The exit code is 1
if one differs in silence.
"""

import collections
import math
import pathlib
import sys

import numpy as np

import saltus

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from reference_motions import CLOSE, Ends, arguments, extrapolated, limited, run, step, verdict  # noqa: E402

STEP = 1e-30  # of derivatives by complex numbers


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
        for guard in self.modes[self.mode]["guards"]:  # above zero at the start
            lift = max(0.0, 0.3 - guard["number"](0.0, self.initial, self.p))
            guard["number"] = lambda t, x, p, g=guard["number"], lift=lift: g(t, x, p) + lift

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

class Reference:
    """part: of the shortest time in which a number changes, the length of a step."""

    def __init__(self, system, part):
        self.s, n0, self.part = system, len(system.initial), part
        self.control = system.control if system.m else np.zeros((system.K, 0))
        self.columns = n0 + system.K * system.m + system.P + 1
        self.events = []
        self.just = ()  # the number that the last event left at zero
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

    def numbers(self, t, y):
        """Of guards, then of conditions: those of integer parts have two."""
        mode, p = self.s.modes[self.mode], self.s.p
        x, slope = y[:, 0], self.flow(self.sides, t, y)[:, 0]

        def at(item):
            value = complex(item["number"](t + 1j * STEP, x + 1j * STEP * slope, p))
            return value.real, value.imag / STEP

        found = [(("guard", i, 0), *at(guard)) for i, guard in enumerate(mode["guards"])]
        for i, (condition, side) in enumerate(zip(mode["conditions"], self.sides)):
            c, rate = at(condition)
            if condition["floor"]:
                found += [(("condition", i, -1), c - side, rate), (("condition", i, 1), side + 1 - c, -rate)]
            else:
                found.append((("condition", i, -2 * side), side * c, side * rate))
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
        if min([1.0] + [g["number"](self.t, self.x, self.s.p) for g in self.s.modes[self.mode]["guards"]]) < 1e-9:
            raise Ends("a guard is not above zero on entry")

    def columns_here(self):
        return np.concatenate([self.x[:, None], self.S], axis=1)

    def run(self):
        s = self.s
        self.fixed = self.seeds()
        self.enter()
        for k in range(s.K):
            self.interval = k
            if k > 0:
                before = self.flow(self.sides, self.t, self.columns_here())[:, 0]
                self.fixed = self.seeds()
                after = self.flow(self.sides, self.t, self.columns_here())[:, 0]
                self.S[:, -1] += (before - after) * k / s.K
            end = s.duration * (k + 1) / s.K
            while self.t < end:
                self.step(end)
        self.S[:, -1] += self.flow(self.sides, self.t, self.columns_here())[:, 0]

    def step(self, end):
        mode, t = self.s.modes[self.mode], self.t
        fast = min([1.0] + [c["fast"] for c in mode["conditions"] + mode["guards"]])
        h = min(self.part * fast, 0.05, end - t)
        if end - t - h < 1e-12:
            h = end - t
        y = self.columns_here()

        def advance(s):
            return extrapolated(lambda r, z: self.flow(self.sides, t + r, z), y, s)

        when, y, which = step(advance, lambda s, z: self.numbers(t + s, z), y, h, self.just)
        if which is not None and end - t - when < CLOSE:
            raise Ends("an event where the control jumps, or at the end")
        self.t = end if abs(t + when - end) < 1e-12 else t + when
        self.x, self.S, self.just = y[:, 0].copy(), y[:, 1:].copy(), ()
        if which is not None:
            self.happen(y, which)

    def happen(self, y, which):
        mode, (p, _) = self.s.modes[self.mode], self.fixed
        X = self.stacked(y)
        kind, i, by = which
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
            self.just = (("condition", i, -by),)
            return
        state = X + 1j * STEP * np.concatenate([np.zeros((len(f), 1)), np.outer(f, dt)], axis=1)
        time = self.t + 1j * STEP * np.concatenate([[0.0], dt])
        while i is not None:
            if len(self.events) > 400 or (len(self.events) > 20 and self.events[-20][0] == self.t):
                raise Ends("many events, or events without time passing that do not end")
            item = self.s.modes[self.mode]["guards"][i]
            self.events.append((self.t, self.mode, i, item["next"]))
            state = np.array([value + np.zeros(self.columns + 1, dtype=complex) for value in item["reset"](time, state, p)])
            self.mode = item["next"]
            # A guard that is below zero behind the reset has its transition at once, as a part of it.
            values = [g["number"](self.t, state[:, 0].real, self.s.p) for g in self.s.modes[self.mode]["guards"]]
            i = next((k for k, value in enumerate(values) if value < -1e-9), None)
        self.x = state[:, 0].real.copy()
        self.S = state[:, 1:].imag / STEP
        self.enter()
        after = self.flow(self.sides, self.t, self.columns_here())[:, 0]
        self.S = self.S - np.outer(after, dt)


# ---------------------------------------------------------------------------------------------------------------------

def compare(seed, seconds=0):
    """What became of one system, and a text about it. Where results differ, the reference is computed again with shorter
    steps."""
    kind, text = compare_with(seed, 0.5, seconds)
    return compare_with(seed, 0.02, 10 * seconds) if kind == "DIFFERS" else (kind, text)


def compare_with(seed, part, seconds):
    system = System(np.random.default_rng(seed))
    reference = Reference(system, part)
    try:
        with limited(seconds), np.errstate(all="ignore"):
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
    return verdict(worst, by, 1e-9, 1e-7, remark, f"{len(found)} events of {len(reference.events)}")


def of_comparator(frequency, duty):
    """What becomes of y' = 1 - y while sin(2 pi f t) < d, else -y, over 1 s, whose events and end have closed forms."""
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
    try:
        motion = saltus.rollout(saltus.HybridProblem(comparator, mode="on", initial=[0], parameters=[duty], duration=1.0))
    except RuntimeError as error:
        return f"refused: {error}"
    right = len(motion.events) == len(times) and abs(motion.final[0] - y) < 1e-10
    return "right" if right else "misses events, with a remark" if motion.remark else "misses events in silence"


def main():
    parser = arguments(1000)
    parser.add_argument("--comparators", type=int, default=0, help="guards of 1 to 10000 Hz, with closed forms")
    options = parser.parse_args()
    rng = np.random.default_rng(options.first)
    found = collections.Counter()
    for _ in range(options.comparators):
        frequency, duty = 10 ** rng.uniform(0, 4), rng.uniform(0.02, 0.95)
        if rng.uniform() < 0.5:
            frequency = round(frequency)
        what = of_comparator(frequency, duty)
        found[what.split(":")[0]] += 1
        if what != "right":
            print(f"comparator of {frequency} Hz, {duty}: {what}", flush=True)
    if options.comparators:
        print("comparators: " + ", ".join(f"{kind}: {count}" for kind, count in sorted(found.items())))
    return 0 if run(compare, options) and not found["misses events in silence"] else 1


if __name__ == "__main__":
    sys.exit(main())
