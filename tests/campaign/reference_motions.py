"""What the campaigns of random hybrid systems share: an integrator of their own, zeros within its steps, and the counts.

Numbers whose zeros end a piece of a motion are above zero within it. numbers(s, y) returns of each its name, its value and
its rate, at the state y after a part s of a step; advance(s) returns that state.
"""

import argparse
import collections
import contextlib
import signal

import numpy as np

CLOSE = 1e-8  # s: two events that are as close are not told apart
SHORTEST = 1e-9  # s: of a step


class Ends(Exception):
    """The reference does not go on: events at the same time, a motion that has no continuation, too many events."""


def extrapolated(f, y, h, tolerance=1e-13):
    """One step of Gragg's method, extrapolated until two diagonal entries agree (Bulirsch and Stoer); None if they do not."""
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


def locate(advance, numbers, i, low, high):
    """Where number i, above zero at low and not at high, falls through zero: Newton's method, safeguarded by bisection."""
    at = 0.5 * (low + high)
    for _ in range(100):
        _, value, rate = numbers(at, advance(at))[i]
        if value > 0:
            low = at
        else:
            high = at
        newton = at - value / rate if rate != 0 else -1.0
        next_at = newton if low < newton < high else 0.5 * (low + high)
        if abs(next_at - at) < 1e-16:
            break
        at = next_at
    return at


def dip(advance, numbers, i, h):
    """Where number i, above zero at both ends of a step, is not above zero in between; None if it is."""
    low, high = 0.0, h
    for _ in range(60):
        s = 0.5 * (low + high)
        _, value, rate = numbers(s, advance(s))[i]
        if value <= 0:
            return s
        if value > abs(rate) * (high - low):
            return None
        low, high = (s, high) if rate < 0 else (low, s)
    return None


def step(advance, numbers, y, h, just=()):
    """A step of length h at most, to the first fall of a number through zero in it: the length, the state and the name of
    the number, or None. `just` has the names of numbers that are zero at the beginning and rise."""
    begin = numbers(0.0, y)
    while True:
        end = advance(h)
        if end is not None and np.all(np.isfinite(end)):
            after = numbers(h, end)
            falls = [i for i in range(len(begin)) if after[i][1] <= 0]
            if not any(begin[i][0] in just for i in falls):
                break
        h /= 2
        if h < SHORTEST:
            raise Ends("the flow is too fast, or a number returns to zero at once")
    located = [(locate(advance, numbers, i, 0.0, h), i) for i in falls]
    for i, ((_, value, rate), (_, value_after, rate_after)) in enumerate(zip(begin, after)):
        if begin[i][0] not in just and min(value, value_after) > 0 and rate < 0 < rate_after:
            below = dip(advance, numbers, i, h)
            if below is not None:
                located.append((locate(advance, numbers, i, 0.0, below), i))
    if not located:
        return h, end, None
    located.sort()
    if len(located) > 1 and located[1][0] - located[0][0] < CLOSE:
        raise Ends("two events at the same time")
    when, i = located[0]
    return when, advance(when), begin[i][0]


@contextlib.contextmanager
def limited(seconds):
    """Ends the reference after so many seconds; 0 is no limit."""
    def end(*_):
        raise Ends(f"it takes more than {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def verdict(worst, by, most, most_by, remark, text):
    """What became of a system whose states differ by `worst` and derivatives by `by`."""
    if worst <= most and by <= most_by:
        return ("agrees, with a remark" if remark else "agrees"), remark
    text = f"states {worst:.1e}, derivatives {by:.1e}, {text}, remark {remark!r}"
    return ("differs, with a remark" if remark else "DIFFERS"), text


def arguments(count):
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=count)
    parser.add_argument("--first", type=int, default=0, help="seed of the first system")
    parser.add_argument("--seconds", type=int, default=0, help="the longest time of a reference; 0: no limit")
    parser.add_argument("--verbose", action="store_true")
    return parser


def run(compare, options):
    """Compares systems until as many as asked for have a reference, and prints the counts. Returns whether none differs in
    silence."""
    counts, reasons = collections.Counter(), collections.Counter()
    seed = options.first
    while sum(counts.values()) - counts["no reference"] < options.count:
        kind, text = compare(seed, options.seconds)
        counts[kind] += 1
        if kind == "no reference":
            reasons[text] += 1
        if kind == "DIFFERS" or (options.verbose and kind not in ("agrees", "no reference")):
            print(f"{seed}: {kind}: {text}", flush=True)
        seed += 1
    print(", ".join(f"{kind}: {count}" for kind, count in sorted(counts.items())))
    for reason, count in reasons.most_common():
        print(f"  no reference, {reason}: {count}")
    return not counts["DIFFERS"]
