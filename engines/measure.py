# What is measured of an engine, from final states alone: loss and differences on task 3, and what an impact does to a
# displacement.
import math
import statistics

from client import DriverError, final_states

STEPS = 480
INITIAL = [[-2, -2, 0, 0], [-1, -1, 0, 0]]
FORCE = [3, 3]
EFFORT = 0.1
# The entries of the initial state that the table has: (disc, number).
ENTRIES = {"p1x": (0, 0), "p2x": (1, 0), "v1x": (0, 2), "v2x": (1, 2)}
# A scene of discs of radius 0.2 m and 1 kg, as the protocol has it. bodies: rows of [px, py, vx, vy].
def scene_of(bodies, controlled=(), restitution=1, steps=STEPS, duration=1):
    names = ["striker", "target"]
    return {
        "name": "engines",
        "duration": duration,
        "steps": steps,
        "gravity": [0, 0],
        "bodies": [{"name": name, "radius": 0.2, "mass": 1, "fixed": False, "position": row[:2], "velocity": row[2:]}
                   for name, row in zip(names, bodies)],
        "planes": [],
        "contact": {"restitution": restitution, "friction": 0, "stiffness": 1e4, "damping": 0},
        "control": {"bodies": list(controlled), "initial": [FORCE for _ in controlled]},
    }


# When the discs of task 3 first touch, in s: the first zero of their distance less twice the radius.
def exact_impact_time(initial):
    (x1, y1, vx1, vy1), (x2, y2, vx2, vy2) = initial

    def gap(t):
        x = x2 - x1 + (vx2 - vx1) * t - FORCE[0] * t * t / 2
        y = y2 - y1 + (vy2 - vy1) * t - FORCE[1] * t * t / 2
        return math.hypot(x, y) - 0.4

    after = next(k / 1000 for k in range(1001) if gap(k / 1000) <= 0)
    before = after - 1e-3
    while before < (middle := (before + after) / 2) < after:
        before, after = (middle, after) if gap(middle) > 0 else (before, middle)
    return after


# The exact loss of task 3: one impact, at which the discs exchange their velocities along the line of centres.
def exact_loss(initial):
    t = exact_impact_time(initial)
    (x1, y1, vx1, vy1), (x2, y2, vx2, vy2) = initial
    ax, ay = FORCE
    nx, ny = x2 + vx2 * t - x1 - vx1 * t - ax * t * t / 2, y2 + vy2 * t - y1 - vy1 * t - ay * t * t / 2
    length = math.hypot(nx, ny)
    nx, ny = nx / length, ny / length
    approach = (vx1 + ax * t - vx2) * nx + (vy1 + ay * t - vy2) * ny
    x = x2 + vx2 * t + (vx2 + approach * nx) * (1 - t)
    y = y2 + vy2 * t + (vy2 + approach * ny) * (1 - t)
    return x * x + y * y + EFFORT * (ax * ax + ay * ay)


# Its gradient, by ENTRIES: central differences of a closed form, good to some 1e-9.
def exact_gradient(width=1e-5):
    return {entry: (exact_loss(displaced(entry, width)) - exact_loss(displaced(entry, -width))) / (2 * width)
            for entry in ENTRIES}


# The loss of task 3 for each of the initial states.
def losses(command, initials, steps=STEPS):
    scene = scene_of(INITIAL, ["striker"], steps=steps)
    states = final_states(command, scene, [(steps, 1, initial, [[FORCE]]) for initial in initials])
    effort = EFFORT * (FORCE[0]**2 + FORCE[1]**2)
    return [state[1][0]**2 + state[1][1]**2 + effort for state in states]


# The initial state of task 3, with one number of it displaced.
def displaced(entry, by):
    initial = [list(row) for row in INITIAL]
    disc, number = ENTRIES[entry]
    initial[disc][number] += by
    return initial


# Loss of task 3, and {width: {entry: central difference}}.
def differences(command, widths, steps=STEPS):
    initials = [INITIAL]
    for width in widths:
        for entry in ENTRIES:
            initials += [displaced(entry, width), displaced(entry, -width)]
    values = losses(command, initials, steps)
    pairs = iter(zip(values[1::2], values[2::2]))
    return values[0], {width: {entry: (up - down) / (2 * width) for entry, (up, down) in zip(ENTRIES, pairs)}
                       for width in widths}


PHASES = 9
SPEED = 3  # m/s, of approach
IMPACT_DURATION = 0.5  # s


# e, keep and feed of a head-on impact, medians over the phase of the impact in a step: e the speed after over that
# before, keep what is left just after the impact of a displacement of the first disc towards the other, feed the share
# of the displacement that the velocity is given in a step.
def impact(command, steps, is_float32, restitution=1):
    h = IMPACT_DURATION / steps
    delta = (0.05 if is_float32 else 1e-3) * SPEED * h
    initials, gaps = [], []
    for phase in range(PHASES):
        gap = SPEED * h * (steps // 2 + (phase + 0.5) / PHASES)
        gaps.append(gap)
        for by in (delta, -delta):
            initials.append([[-0.4 - gap + by, 0, SPEED, 0], [0, 0, 0, 0]])
    scene = scene_of(initials[0], restitution=restitution, steps=steps, duration=IMPACT_DURATION)
    states = final_states(command, scene, [(steps, IMPACT_DURATION, initial, []) for initial in initials])
    relative = [[a - b for a, b in zip(*state)] for state in states]
    e, keep, feed = [], [], []
    for gap, up, down in zip(gaps, relative[0::2], relative[1::2]):
        by_position = (up[0] - down[0]) / (2 * delta)
        by_velocity = (up[2] - down[2]) / (2 * delta)
        e.append(-(up[2] + down[2]) / 2 / SPEED)
        feed.append(h * by_velocity)
        keep.append(by_position - by_velocity * (IMPACT_DURATION - gap / SPEED))
    return {"e": statistics.median(e), "keep": statistics.median(keep), "feed": statistics.median(feed)}


OBLIQUE_NORMAL, OBLIQUE_ALONG = (0.6, 0.8), (0.8, -0.6)  # of a half-plane through OBLIQUE_POINT
OBLIQUE_POINT = (1, 2)
OBLIQUE_SPEEDS = (3, 4)  # m/s, towards the half-plane and along it


# Speeds away from a tilted half-plane and along it, of a disc of 2 kg that struck it. Exact: e * 3 and
# 4 - friction * (1 + e) * 3. Raises if it is on the other side.
def oblique_impact(command, restitution, friction, steps=240):
    into, along = OBLIQUE_SPEEDS
    point = [p + (0.2 + into * IMPACT_DURATION / 2) * n for p, n in zip(OBLIQUE_POINT, OBLIQUE_NORMAL)]
    velocity = [along * t - into * n for n, t in zip(OBLIQUE_NORMAL, OBLIQUE_ALONG)]
    scene = scene_of([point + velocity], restitution=restitution, steps=steps, duration=IMPACT_DURATION)
    scene["bodies"][0]["mass"] = 2
    scene["contact"]["friction"] = friction
    scene["planes"] = [{"name": "wall", "point": list(OBLIQUE_POINT), "normal": [3, 4]}]
    x, y, vx, vy = final_states(command, scene, [(steps, IMPACT_DURATION, [point + velocity], [])])[0][0]
    height = (x - OBLIQUE_POINT[0]) * OBLIQUE_NORMAL[0] + (y - OBLIQUE_POINT[1]) * OBLIQUE_NORMAL[1]
    if height < 0.1:
        raise DriverError(f"a disc of radius 0.2 m ends {height:.3f} m above the half-plane that it struck")
    return [vx * x + vy * y for x, y in (OBLIQUE_NORMAL, OBLIQUE_ALONG)]


# The speed away from a fixed disc that was struck head-on at 3 m/s. Raises if the fixed disc moves, or is passed
# through.
def rebound_from_fixed(command, restitution, steps=240):
    initial = [[0.4 + SPEED * IMPACT_DURATION / 2, 0, -SPEED, 0], [0, 0, 0, 0]]
    scene = scene_of(initial, restitution=restitution, steps=steps, duration=IMPACT_DURATION)
    scene["bodies"][1].update(fixed=True, mass=None)
    moving, fixed = final_states(command, scene, [(steps, IMPACT_DURATION, initial, [])])[0]
    if fixed != initial[1] or moving[0] < 0.3:
        raise DriverError(f"a disc that struck a fixed one ends at x = {moving[0]:.3f} m, the fixed one at {fixed}")
    return moving[2]
