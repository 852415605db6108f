# What is measured of an engine, from final states alone: loss and differences on task 3, and what an impact does to a
# displacement.
import statistics

from client import final_states

STEPS = 480
INITIAL = [[-2, -2, 0, 0], [-1, -1, 0, 0]]
FORCE = [3, 3]
EFFORT = 0.1
# The entries of the initial state that the table has: (disc, number).
ENTRIES = {"p1x": (0, 0), "p2x": (1, 0), "v1x": (0, 2), "v2x": (1, 2)}
# Of the exact motion (data/exact_references.json), by ENTRIES.
EXACT_LOSS = 2.059098108
EXACT_GRADIENT = {"p1x": -0.398680, "p2x": -0.321305, "v1x": -0.497754, "v2x": -0.222132}


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
        for by in (0, delta, -delta):
            initials.append([[-0.4 - gap + by, 0, SPEED, 0], [0, 0, 0, 0]])
    scene = scene_of(initials[0], restitution=restitution, steps=steps, duration=IMPACT_DURATION)
    states = final_states(command, scene, [(steps, IMPACT_DURATION, initial, []) for initial in initials])
    relative = [[a - b for a, b in zip(*state)] for state in states]
    e, keep, feed = [], [], []
    for gap, middle, up, down in zip(gaps, relative[0::3], relative[1::3], relative[2::3]):
        by_position = (up[0] - down[0]) / (2 * delta)
        by_velocity = (up[2] - down[2]) / (2 * delta)
        e.append(-middle[2] / SPEED)
        feed.append(h * by_velocity)
        keep.append(by_position - by_velocity * (IMPACT_DURATION - gap / SPEED))
    return {"e": statistics.median(e), "keep": statistics.median(keep), "feed": statistics.median(feed)}
