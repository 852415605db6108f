#!/usr/bin/env python3
"""Writes the tables of README.md and docs/ that the programs and schemas determine.

usage: scripts/reference.py [--build=build/release] [--check] [NAME...]

A table stands between the lines "<!-- table: NAME -->" and "<!-- end -->" of a page. With --check nothing is written: the
exit code is 1 if a page is out of date. NAME: only these tables.

The answers are those of the programs. A feature is a small scene: a contact model or a solver supports it if it does not
answer "not_applicable". Keys of scene files are compared with those that the reader accepts; a required key must be refused
if it is missing, and a default must give the result that the missing key gives.
"""

import argparse
import copy
import functools
import json
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
PROGRAMS = ["saltus_audit", "saltus_bodies", "saltus_solve", "saltus_sweep", "saltus_identify", "saltus_scene",
            "saltus_simulate", "saltus_replay", "saltus_reproduce", "two_balls", "bouncing_ball"]
# What stands for many programs.
KINDS = {"two_balls": "the problems", "bouncing_ball": "the hybrid systems"}
TASKS = {"bounce_once": "one bounce", "ground_wall": "ground and wall", "two_balls": "two balls"}
MARK = re.compile(r"(<!-- table: ([a-z ]+) -->\n).*?(<!-- end -->)", re.S)


class Wrong(Exception):
    """A page or a table of this script disagrees with the programs."""


# ---------------------------------------------------------------------------------------------------------------------
# Scenes that show features
# ---------------------------------------------------------------------------------------------------------------------


def assign(tree, path, value):
    """Sets the entry of a path such as "bodies.0.inertia"; a value of None removes it."""
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    for part in parents:
        tree = tree[part] if isinstance(part, int) else tree.setdefault(part, {})
    if value is None:
        tree.pop(last, None)
    elif isinstance(last, int) and last == len(tree):
        tree.append(value)
    else:
        tree[last] = value


def scene(*changes):
    """Two discs, of which a force pushes the first against the second, with (path, value) pairs of changes."""
    made = {
        "name": "probe", "duration": 1, "steps": 24, "optimize": "control",
        "bodies": [{"name": "a", "radius": 0.1, "mass": 1, "position": [-0.5, 0], "velocity": [0.5, 0]},
                   {"name": "b", "radius": 0.1, "mass": 1, "position": [0, 0.02]}],
        "control": {"bodies": ["a"], "initial": [[2, 0.1]]},
        "objective": {"terminal": [{"body": "b", "quantity": "position", "target": [1, 0.2]}], "effort": 0.1},
    }
    for path, value in changes:
        assign(made, path, copy.deepcopy(value))
    return made


LAUNCH = (("optimize", "velocity"), ("control", None), ("objective.effort", None))
SPIN = (("bodies.0.inertia", "solid"), ("bodies.1.inertia", "solid"))
TORQUE = (*SPIN, ("control.torque", ["a"]), ("control.initial", [[2, 0.1, 0]]))
POST = ("bodies.2", {"name": "post", "radius": 0.1, "fixed": True, "position": [3, 3]})
DESIGN = ("optimize", [{"parameter": "mass.b"}, "control"])
TERM = "objective.terminal.0"
RUNNING = ("objective.running", [{"body": "a", "quantity": "position", "target": [[0, 0, 0]], "weight": 0.1}])
VIA = ("objective.via", [{"body": "a", "time": 0.2, "quantity": "position", "target": [0, 0], "weight": 0.1}])
REGION = ((f"{TERM}.target", None), (f"{TERM}.min", [1, None]), (f"{TERM}.max", [2, 0.3]))
LIMIT = ("objective.limits", [{"body": "a", "speed": {"max": 3}, "at": "end"}])
FREE = ("objective.duration", {"free": True, "min": 0.5, "max": 2, "weight": 0.1})
PLANE = ("planes", [{"name": "wall", "point": [3, 0], "normal": [-1, 0]}])
SEGMENT = ("segments", [{"name": "gate", "from": [2, -1], "to": [2, 1]}])
POLYGON = ("polygons", [{"name": "box", "points": [[2, -1], [3, -1], [3, 1]], "solid": "inside"}])
ARC = ("arcs", [{"name": "bend", "center": [2, 0], "radius": 1, "from": -0.5, "to": 0.5}])
POCKET = ("pockets", [{"name": "hole", "position": [3, 0], "radius": 0.05}])
TABLE = ("table", {"friction": 0.1, "gravity": 9.81})
DRAG = ("forces", [{"drag": {"body": "b", "linear": 0.1}}])
SPRING = ("forces", [{"spring": {"body": "b", "to": [0, 1], "stiffness": 0.5, "length": 0.8, "damping": 0.1}}])
PADDLE = ("bodies.2", {"name": "paddle", "radius": 0.1, "path": {"times": [0, 1], "positions": [[3, 3], [3, 2]]}})
MOVING = ("planes", [{"name": "wall", "normal": [-1, 0], "motion": {"times": [0, 1], "positions": [[3, 0], [3.1, 0]]}}])
ALLOYS = ("materials", {"NAME": {"restitution": 1}, "steel": {}})
MATERIALS = (ALLOYS, ("bodies.0.material", "NAME"))
PAIRS = (*MATERIALS, ("pairs", [{"between": ["NAME", "default"], "restitution": 0.6, "friction": 0}]))

MODEL_FEATURES = {
    "friction": scene(("contact.friction", 0.2)),
    "discs that spin": scene(*SPIN),
    "friction and spin": scene(("contact.friction", 0.2), *SPIN),
    "torques": scene(*TORQUE),
    "segments, polygons, arcs": scene(SEGMENT, POLYGON, ARC),
    "table": scene(*LAUNCH, TABLE),
    "pockets": scene(*LAUNCH, POCKET),
    "drag": scene(DRAG),
    "springs": scene(SPRING),
    "prescribed motion of discs": scene(PADDLE),
    "prescribed motion of planes": scene(MOVING),
}
SOLVER_FEATURES = {
    "control": scene(),
    "launch velocity": scene(*LAUNCH),
    "friction": MODEL_FEATURES["friction"],
    "discs that spin": MODEL_FEATURES["discs that spin"],
    "torques": MODEL_FEATURES["torques"],
    "segments": scene(SEGMENT),
    "table": MODEL_FEATURES["table"],
    "pockets": MODEL_FEATURES["pockets"],
    "drag and springs": scene(("forces", DRAG[1] + SPRING[1])),
    "prescribed motion": scene(PADDLE, MOVING),
    "linear term": scene((f"{TERM}.target", None), (f"{TERM}.component", "x")),
    "bounds": scene(("control.max", 5)),
    "terminal equality constraint": scene((f"{TERM}.hard", True)),
    "goal region": scene(*REGION),
    "limit of the speed": scene(LIMIT),
    "running cost": scene(RUNNING),
    "waypoint cost": scene(VIA),
    "free duration": scene(FREE),
    "`no_contact`": scene(POST, ("no_contact", [["a", "post"]])),
}

REQUIRED = "required"  # a default of this kind: the key must be there if the map that it belongs to is
NAME, VECTOR, NUMBER = "name", "[x, y]", "number"
MATERIAL = "one of `materials`, or `default` for none"
# Keys of scene files: path, type, unit, default (REQUIRED, None without one), meaning, a scene that has the key.
KEYS = [
    ("name", NAME, "", REQUIRED, "name of the scene: 1 to 100 characters out of a-z, 0-9 and _", scene()),
    ("duration", NUMBER, "s", REQUIRED, "length of the motion, > 0", scene()),
    ("steps", "integer", "", REQUIRED, "number of equal time steps, 1 to 10^7", scene()),
    ("gravity", VECTOR, "m/s^2", [0, 0], "acceleration of all discs", scene(("gravity", [0.1, 0]))),
    ("bodies", "list", "", REQUIRED, "the discs, at least one", scene()),
    ("bodies[].name", NAME, "", REQUIRED, "unique name: 1 to 100 characters out of A-Z, a-z, 0-9, _, - and .", scene()),
    ("bodies[].radius", NUMBER, "m", REQUIRED, "radius, > 0", scene()),
    ("bodies[].mass", NUMBER, "kg", REQUIRED, "mass, > 0; a fixed disc has none", scene()),
    ("bodies[].fixed", "true or false", "", False, "whether the disc never moves",
     scene(POST)),
    ("bodies[].path", "map", "", None,
     "[prescribed motion](../how-to/forces.md#a-paddle-and-a-moving-wall) of the disc, in place of `mass`, `position` and "
     "`velocity`: the cubic spline through `positions`", scene(PADDLE)),
    ("bodies[].path.times", "list of numbers", "s", REQUIRED, "times that rise, from 0 or before to the end or after", scene(PADDLE)),
    ("bodies[].path.positions", "list of [x, y]", "m", REQUIRED, "position of the centre at each of `times`", scene(PADDLE)),
    ("bodies[].position", VECTOR, "m", REQUIRED, "position of the centre at the start", scene()),
    ("bodies[].velocity", VECTOR, "m/s", [0, 0], "velocity at the start", scene()),
    ("bodies[].inertia", "`none`, `solid` or number", "kg m^2", "none",
     "moment of inertia; `solid` is m r^2 / 2; with `none` the disc has no rotation", scene(*SPIN)),
    ("bodies[].angle", NUMBER, "rad", 0, "angle at the start, counter-clockwise; with `inertia`",
     scene(*SPIN, ("bodies.0.angle", 0.5))),
    ("bodies[].angular_velocity", NUMBER, "rad/s", 0, "angular velocity at the start, counter-clockwise; with `inertia`",
     scene(*SPIN, ("bodies.0.angular_velocity", 0.5))),
    ("bodies[].material", NAME, "", "default", MATERIAL, scene(*MATERIALS)),
    ("planes", "list", "", None, "half-planes; discs stay on the side to which the normal points", scene(PLANE)),
    ("planes[].name", NAME, "", REQUIRED, "unique name", scene(PLANE)),
    ("planes[].point", VECTOR, "m", REQUIRED, "a point of the boundary", scene(PLANE)),
    ("planes[].normal", VECTOR, "", REQUIRED, "normal of any length", scene(PLANE)),
    ("planes[].motion", "map", "", None, "prescribed motion of the plane, in place of `point`: `times` and `positions` as of "
     "`bodies[].path`, of a point of the boundary", scene(MOVING)),
    ("planes[].material", NAME, "", "default", MATERIAL, scene(PLANE, *MATERIALS)),
    ("segments", "list", "", None, "walls of finite length; both sides and the ends are solid", scene(SEGMENT)),
    ("segments[].name", NAME, "", REQUIRED, "unique name; `NAME.a` and `NAME.b` are its ends", scene(SEGMENT)),
    ("segments[].from", VECTOR, "m", REQUIRED, "one end", scene(SEGMENT)),
    ("segments[].to", VECTOR, "m", REQUIRED, "the other end", scene(SEGMENT)),
    ("segments[].material", NAME, "", "default", MATERIAL, scene(SEGMENT, *MATERIALS)),
    ("polygons", "list", "", None, "polygons, solid on one side", scene(POLYGON)),
    ("polygons[].name", NAME, "", REQUIRED, "unique name; `NAME.edge0`, `NAME.corner0` are its parts", scene(POLYGON)),
    ("polygons[].points", "list of [x, y]", "m", REQUIRED, "corners, counter-clockwise", scene(POLYGON)),
    ("polygons[].solid", "`inside` or `outside`", "", REQUIRED, "which side is solid", scene(POLYGON)),
    ("polygons[].material", NAME, "", "default", MATERIAL, scene(POLYGON, *MATERIALS)),
    ("arcs", "list", "", None, "circular walls; both sides and the ends are solid", scene(ARC)),
    ("arcs[].name", NAME, "", REQUIRED, "unique name", scene(ARC)),
    ("arcs[].center", VECTOR, "m", REQUIRED, "centre of the circle", scene(ARC)),
    ("arcs[].radius", NUMBER, "m", REQUIRED, "radius of the circle, > 0", scene(ARC)),
    ("arcs[].from", NUMBER, "rad", REQUIRED, "angle of one end", scene(ARC)),
    ("arcs[].to", NUMBER, "rad", REQUIRED, "angle of the other end, counter-clockwise from `from`", scene(ARC)),
    ("arcs[].material", NAME, "", "default", MATERIAL, scene(ARC, *MATERIALS)),
    ("pockets", "list", "", None, "circles in which a disc is out of play once its centre is there", scene(*LAUNCH, POCKET)),
    ("pockets[].name", NAME, "", REQUIRED, "unique name", scene(*LAUNCH, POCKET)),
    ("pockets[].position", VECTOR, "m", REQUIRED, "centre", scene(*LAUNCH, POCKET)),
    ("pockets[].radius", NUMBER, "m", REQUIRED, "radius, > 0", scene(*LAUNCH, POCKET)),
    ("table", "map", "", None, "a horizontal table, seen from above, on which the discs slide and come to rest",
     scene(*LAUNCH, TABLE)),
    ("table.friction", NUMBER, "", REQUIRED, "coefficient of friction between discs and table, >= 0", scene(*LAUNCH, TABLE)),
    ("table.gravity", NUMBER, "m/s^2", 9.81, "gravity, normal to the table, >= 0", scene(*LAUNCH, TABLE)),
    ("forces", "list", "", None, "[drag and springs](../how-to/forces.md); each entry has one key, `drag` or `spring`",
     scene(DRAG)),
    ("forces[].drag", "map", "", None, "the force -linear * v on a disc; one for each disc", scene(DRAG)),
    ("forces[].drag.body", NAME, "", REQUIRED, "the disc", scene(DRAG)),
    ("forces[].drag.linear", NUMBER, "N s/m", REQUIRED, "the coefficient, >= 0", scene(DRAG)),
    ("forces[].spring", "map", "", None, "a spring with a damper", scene(SPRING)),
    ("forces[].spring.body", NAME, "", REQUIRED, "the disc at one end", scene(SPRING)),
    ("forces[].spring.to", "[x, y] or name", "m", REQUIRED, "the other end: a point, or another disc", scene(SPRING)),
    ("forces[].spring.stiffness", NUMBER, "N/m", REQUIRED, ">= 0", scene(SPRING)),
    ("forces[].spring.length", NUMBER, "m", 0, "length without a force, >= 0", scene(SPRING)),
    ("forces[].spring.damping", NUMBER, "N s/m", 0, "of the velocity along the spring, >= 0; with the length 0 of every "
     "velocity", scene(SPRING)),
    ("contact", "map", "", None, "parameters of all contacts; restitution and friction: of those of what has no material",
     scene(("contact", {"friction": 0}))),
    ("contact.restitution", NUMBER, "", 1.0, "separation speed over approach speed along the normal, in [0, 1]",
     scene(("contact.restitution", 0.5))),
    ("contact.friction", NUMBER, "", 0.0, "coefficient of friction, >= 0", scene(("contact.friction", 0.2))),
    ("contact.stiffness", NUMBER, "N/m", 1e4, "stiffness of contacts, >= 0", scene(("contact.stiffness", 2e4))),
    ("contact.damping", NUMBER, "N s/m", 0.0, "damping of contacts, >= 0", scene(("contact.damping", 5))),
    ("materials", "map", "", None,
     "[materials](../how-to/materials.md) by name: characters as in names of discs, but no -, and not `default`, which is what "
     "has no material",
     scene(ALLOYS)),
    ("materials.NAME.restitution", NUMBER, "", 1.0, "in [0, 1]; if missing, that of `contact`", scene(*MATERIALS)),
    ("materials.NAME.friction", NUMBER, "", 0.0, ">= 0; if missing, that of `contact`", scene(*MATERIALS)),
    ("pairs", "list", "", None, "pairs of materials whose numbers are given, not combined; each pair once", scene(*PAIRS)),
    ("pairs[].between", "[name, name]", "", REQUIRED, "the two materials, which may be the same", scene(*PAIRS)),
    ("pairs[].restitution", NUMBER, "", None, "in [0, 1]; if missing, it is combined", scene(*PAIRS)),
    ("pairs[].friction", NUMBER, "", None, ">= 0; if missing, it is combined", scene(*PAIRS, ("pairs.0.friction", 0.2))),
    ("combine", "`mean`, `product`, `min` or `max`", "", "mean",
     "how the numbers of two materials, or of twice the same, make those of a pair that `pairs` does not give; two things without a "
     "material have those of `contact`",
     scene(*MATERIALS, ("combine", "max"))),
    ("control", "map", "", None, "forces and torques, constant over each step", scene()),
    ("control.bodies", "list of names", "", REQUIRED, "discs on which a force acts", scene()),
    ("control.initial", "list of [x, y]", "N", REQUIRED,
     "initial guess: one constant force for each of these discs; `[x, y, torque]` with a torque in N m", scene()),
    ("control.torque", "list of names", "", None, "those of these discs on which a torque acts too; they need `inertia`",
     scene(*TORQUE)),
    ("control.max", "number or list", "N", None, "bound of each component of the force, for all discs or for each",
     scene(("control.max", 5))),
    ("control.max_norm", "number or list", "N", None, "bound of the norm of the force", scene(("control.max_norm", 5))),
    ("control.max_torque", "number or list", "N m", None, "bound of the torque", scene(*TORQUE, ("control.max_torque", 1))),
    ("objective", "map", "", REQUIRED, "the loss, a sum of the terms below", scene()),
    ("objective.terminal", "list", "", REQUIRED, "terms of the final state; may be empty with `optimize: none`", scene()),
    ("objective.terminal[].body", NAME, "", REQUIRED, "the disc", scene()),
    ("objective.terminal[].quantity", "`position`, `velocity`, `angle` or `angular_velocity`", "", REQUIRED,
     "what the term is about", scene()),
    ("objective.terminal[].target", "[x, y], or number", "as `quantity`", REQUIRED,
     "the term is weight * |q(T) - target|^2; a number for rotations", scene()),
    ("objective.terminal[].component", "`x` or `y`", "", None,
     "in place of `target`: the term is weight * q_component(T); with `hard: true`, `min` or `max`, a number there is a constraint of "
     "this component alone",
     scene((f"{TERM}.target", None), (f"{TERM}.component", "x"))),
    ("objective.terminal[].weight", NUMBER, "1/`quantity`^2", 1.0, "weight", scene((f"{TERM}.weight", 2))),
    ("objective.terminal[].hard", "true or false", "", False,
     "`true`: q(T) = target is a constraint, without a weight", scene((f"{TERM}.hard", True))),
    ("objective.terminal[].min", "[x, y], or number", "as `quantity`", None,
     "in place of `target`: min <= q(T) is a constraint; `null` is no bound of a component", scene(*REGION)),
    ("objective.terminal[].max", "[x, y], or number", "as `quantity`", None,
     "in place of `target`: q(T) <= max is a constraint", scene(*REGION)),
    ("objective.effort", NUMBER, "1/(N^2 s)", 0, "adds effort * integral of |u|^2 dt; with a control", scene()),
    ("objective.running", "list", "", None, "adds weight * integral of |q - target(t)|^2 dt", scene(RUNNING)),
    ("objective.running[].body", NAME, "", REQUIRED, "the disc", scene(RUNNING)),
    ("objective.running[].quantity", "`position` or `velocity`", "", REQUIRED, "what the term is about", scene(RUNNING)),
    ("objective.running[].target", "list of [t, x, y]", "s and as `quantity`", REQUIRED,
     "target over time, linear between rows and constant before and after them", scene(RUNNING)),
    ("objective.running[].weight", NUMBER, "1/(`quantity`^2 s)", 1.0, "weight", scene(RUNNING)),
    ("objective.via", "list", "", None, "waypoint costs: weight * |q(t) - target|^2", scene(VIA)),
    ("objective.via[].body", NAME, "", REQUIRED, "the disc", scene(VIA)),
    ("objective.via[].time", NUMBER, "s", REQUIRED, "the time t, between 0 and the duration", scene(VIA)),
    ("objective.via[].quantity", "`position` or `velocity`", "", REQUIRED, "what the term is about", scene(VIA)),
    ("objective.via[].target", VECTOR, "as `quantity`", REQUIRED, "target", scene(VIA)),
    ("objective.via[].weight", NUMBER, "1/`quantity`^2", 1.0, "weight", scene(VIA)),
    ("objective.via[].hard", "true or false", "", False, "`true`: q(t) = target is a constraint, without a weight",
     scene(VIA, ("objective.via.0.weight", None), ("objective.via.0.hard", True))),
    ("objective.limits", "list", "", None, "bounds of the speed, which are constraints", scene(LIMIT)),
    ("objective.limits[].body", NAME, "", REQUIRED, "the disc", scene(LIMIT)),
    ("objective.limits[].speed", "map", "", REQUIRED, "the bounds", scene(LIMIT)),
    ("objective.limits[].speed.max", NUMBER, "m/s", REQUIRED, "the greatest speed, > 0", scene(LIMIT)),
    ("objective.limits[].at", "`end` or `always`", "", "always", "when the bound holds", scene(LIMIT)),
    ("objective.duration", "map", "", None, "a free duration", scene(FREE)),
    ("objective.duration.free", "`true`", "", REQUIRED, "states that the duration is free", scene(FREE)),
    ("objective.duration.min", NUMBER, "s", REQUIRED, "shortest duration; equal to `max`, the duration is fixed", scene(FREE)),
    ("objective.duration.max", NUMBER, "s", REQUIRED, "longest duration", scene(FREE)),
    ("objective.duration.weight", NUMBER, "1/s", 0, "adds weight * T", scene(FREE)),
    ("no_contact", "list of [disc, disc or plane]", "", None, "pairs that must not touch",
     scene(POST, ("no_contact", [["a", "post"]]))),
    ("optimize", "`control`, `velocity`, `position` or `none`, or a list", "", REQUIRED,
     "what a solver changes: the control, or velocities or positions at the start; a list has one of these at most, and "
     "names of [parameters of the scene](../how-to/design.md), or maps with bounds", scene()),
    ("optimize[].parameter", "name", "", REQUIRED, "a parameter of the scene", scene(DESIGN)),
    ("optimize[].min", NUMBER, "as the parameter", None, "its least value", scene(DESIGN, ("optimize.0.min", 0.5))),
    ("optimize[].max", NUMBER, "as the parameter", None, "its largest value", scene(DESIGN, ("optimize.0.max", 2))),
    ("free", "list of names", "", None, "discs whose velocities or positions are free; default: all that move",
     scene(*LAUNCH, ("free", ["a"]))),
    ("free_spin", "list of names", "", None, "discs whose angular velocities are free too; with `optimize: velocity`",
     scene(*LAUNCH, *SPIN, ("free_spin", ["a"]))),
]

# ---------------------------------------------------------------------------------------------------------------------
# Answers of the programs
# ---------------------------------------------------------------------------------------------------------------------


class Programs:
    """The programs of a build."""

    def __init__(self, build, folder):
        self.build, self.folder = build, folder

    def run(self, program, *flags, codes=(0, 1)):
        done = subprocess.run([self.build / "bin" / program, *flags], text=True, capture_output=True, check=False, cwd=ROOT,
                              env={"COLUMNS": "1000", "PATH": "/usr/bin:/bin"})
        if done.returncode not in codes:
            raise Wrong(f"{program} {' '.join(map(str, flags))}: exit code {done.returncode}: {done.stderr}")
        return done

    def solve(self, made, *flags, codes=(0, 1)):
        """What saltus_solve answers to a scene; the JSON, or for exit code 2 the message."""
        path = self.folder / "probe.yaml"
        path.write_text(json.dumps(made), encoding="utf-8")
        done = self.run("saltus_solve", f"--scene={path}", "--json", "--progress=none", *flags, codes=codes)
        return done.stderr if done.returncode == 2 else json.loads(done.stdout)

    @functools.cache
    def solvers(self):
        """The names of all solvers but auto, whose runs have the name of another one, and global, which runs mode_search."""
        names = [line.split()[0] for line in self.run("saltus_solve", "--solver=list").stdout.splitlines() if line.strip()]
        return [name for name in names if name not in ("auto", "global")]

    @functools.cache
    def support(self, made, key):
        """{name: whether it does not answer not_applicable}; key: "contact" or "solver"."""
        flags = (["--contact=all", "--solver=none"] if key == "contact" else
                 ["--contact=event", f"--solver={','.join(self.solvers())}", "--iterations=1", "--search_work=100"])
        return {run[key]: run["termination"] != "not_applicable" for run in self.solve(json.loads(made), *flags)["runs"]}

    def supports(self, made, key):
        return self.support(json.dumps(made), key)

    @functools.cache
    def flags(self):
        """{group: {flag: (explanation, programs)}}, in the order of the help texts."""
        groups = {}
        for program in PROGRAMS:
            group = None
            for line in self.run(program, "-h").stdout.splitlines():
                found = re.fullmatch(r"  --(\S+)\s+(.*)", line)
                if found:
                    flags = groups.setdefault(re.sub(r" \(default: .*\)$", "", group), {})
                    flags.setdefault(found[1], (found[2], []))[1].append(program)
                elif line and not line.startswith(" "):
                    group = line
        # A flag of several groups is listed in the first.
        seen = {}
        for group, flags in groups.items():
            for flag in list(flags):
                if flag in seen:
                    groups[seen[flag]][flag][1].extend(flags.pop(flag)[1])
                else:
                    seen[flag] = group
        return {group: flags for group, flags in groups.items() if flags}

    @functools.cache
    def audits(self, task):
        """The audits of all contact models on a task, by name."""
        done = self.run("saltus_audit", f"--scene=problems/{task}.yaml", "--contact=all", "--json", "--progress=none")
        return {item["contact"]: item for item in json.loads(done.stdout)["audits"]}


# ---------------------------------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------------------------------


def table(heads, rows):
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
                     for row in [heads, ["---"] * len(heads), *rows])


def code(names):
    return ", ".join(f"`{name}`" for name in names)


def features(programs, key, scenes):
    answers = {feature: programs.supports(made, key) for feature, made in scenes.items()}
    names = next(iter(answers.values()))
    return table([{"contact": "contact model"}.get(key, key), *scenes],
                 [[f"`{name}`", *("yes" if answers[f][name] else "" for f in scenes)] for name in names])


def takers(support):
    """The names that support something, as briefly as it can be said."""
    yes, no = [name for name, taken in support.items() if taken], [name for name, taken in support.items() if not taken]
    if not no:
        return "all"
    return f"all but {code(no)}" if len(no) <= 5 else code(yes)


def users(programs, key):
    """The contact models whose loss depends on a parameter of contacts."""
    other = {"restitution": 0.5, "stiffness": 2e4, "damping": 5}[key]
    losses = [{run["contact"]: run.get("loss") for run in programs.solve(
        scene(("bodies.1.position", [0, 0.06]), *changes), "--contact=all", "--solver=none")["runs"]}
        for changes in ([], [(f"contact.{key}", other)])]
    return {name: loss is not None and losses[1][name] is not None and loss != losses[1][name]
            for name, loss in losses[0].items()}


def places(path):
    """A key's path with indices: "bodies[].name" is "bodies.0.name". Only the third disc is fixed, or has a path."""
    return path.replace("[]", ".2" if path.startswith(("bodies[].fixed", "bodies[].path")) else ".0")


def check_keys(programs):
    """Compares KEYS with what the reader of scene files accepts, requires and takes as a default."""
    known = {}
    for path, *_, made in KEYS:
        parent, _, key = path.rpartition(".")
        known.setdefault(parent, [{}, made])[0][key] = None
    for parent, (keys, made) in known.items():
        wrong = copy.deepcopy(made)
        assign(wrong, f"{places(parent)}.no_such_key" if parent else "no_such_key", 1)
        answer = programs.solve(wrong, "--contact=event", "--solver=none", codes=(2,))
        accepted = set(re.search(r"expected one of (.*?)(?:;|$)", answer.splitlines()[0])[1].split(", "))
        if accepted != set(keys):
            raise Wrong(f"keys of '{parent}': the reader has {sorted(accepted)}, scripts/reference.py {sorted(keys)}")

    def result(made):
        runs = programs.solve(made, "--contact=event", "--solver=none")["runs"]
        return [{key: value for key, value in run.items() if key != "seconds"} for run in runs]

    for path, _, _, default, _, made in KEYS:
        place = places(path)
        without, of_wrong_type = copy.deepcopy(made), copy.deepcopy(made)
        assign(without, place, None)
        assign(of_wrong_type, place, {"no_such_key": [[]]})
        answer = programs.solve(of_wrong_type, "--contact=event", "--solver=none", codes=(2,))
        if path.split(".")[0].replace("[]", "") not in answer:
            raise Wrong(f"{path}: a value of the wrong type is refused with: {answer}")
        if default == REQUIRED:
            programs.solve(without, "--contact=event", "--solver=none", codes=(2,))
            continue
        if default is None:
            if path not in ("control", "control.torque", "objective.terminal[].component", "bodies[].path", "planes[].motion",
                            "forces[].drag", "forces[].spring"):
                result(without)
            continue
        if path == "bodies[].fixed":
            without["bodies"][2]["mass"] = 1
        with_default = copy.deepcopy(without)
        assign(with_default, place, default)
        if result(without) != result(with_default):
            raise Wrong(f"{path}: {default} is not what a missing key means")


def scene_keys(programs):
    check_keys(programs)
    rows, of_parent = [], {}
    for path, kind, unit, default, meaning, made in KEYS:
        parent, _, key = path.rpartition(".")
        uses = parent == "contact" and key != "friction"
        support = (takers(users(programs, key) if uses else programs.supports(made, "contact")),
                   takers(programs.supports(made, "solver")))
        of_parent[path] = support
        if of_parent.get(parent.removesuffix("[]")) == support:
            support = ("", "")  # as its parent
        shown = default if default == REQUIRED else "" if default is None else f"`{json.dumps(default)}`".replace('"', "")
        rows.append([f"`{path}`", kind, unit, shown, meaning, *support])
    return table(["key", "type", "unit", "default", "meaning", "contact models", "solvers, with `event`"], rows)


def flag_tables(programs):
    parts = []
    for group, flags in programs.flags().items():
        rows = [[f"`--{flag}`", explanation,
                 ", ".join(KINDS.get(p) or code([p]) for p in sorted(takes, key=PROGRAMS.index))]
                for flag, (explanation, takes) in flags.items()]
        parts.append(f"### {group}\n\n" + table(["flag", "meaning", "programs"], rows))
    return "\n\n".join(parts)


def options(programs):
    rows, model = [], ""
    for line in programs.run("saltus_solve", "--contact=list").stdout.splitlines():
        found = re.fullmatch(r"  :(\w+)=(\S+)\s+(.*)", line)
        if found:
            rows.append([f"`{model}`", f"`{found[1]}`", found[2], found[3]])
        else:
            model = line.split()[0]
    return table(["contact model", "option", "default", "meaning"], rows)


def grouped_verdicts(programs):
    """One row for all contact models with the same verdicts."""
    groups = {}
    for name in programs.audits("two_balls"):
        verdicts = tuple(programs.audits(task)[name]["verdict"] for task in TASKS)
        groups.setdefault(verdicts, []).append(name)
    ranks = ["right", "consistent", "wrong", "wrong sign"]
    order = sorted(groups, key=lambda verdicts: [[*ranks, verdict].index(verdict) for verdict in reversed(verdicts)])
    return table(["contact model", *TASKS.values()], [[code(groups[verdicts]), *verdicts] for verdicts in order])


def all_verdicts(programs):
    rows = []
    for name in programs.audits("two_balls"):
        items = [programs.audits(task)[name] for task in TASKS]
        classes = {}
        for task, item in enumerate(items):
            classes.setdefault(item.get("class", ""), []).append(str(task + 1))
        kind = ", ".join(k if len(classes) == 1 else f"{k} ({', '.join(tasks)})" for k, tasks in classes.items())
        rows.append([f"`{name}`", kind, *(item["verdict"] for item in items),
                     f"`{items[-1]['why']}`" if items[-1].get("why") else ""])
    return table(["contact model", "class (of tasks)", *TASKS.values(), "reason, in the task of two balls"], rows)


def schema_rows(schema, part, path=""):
    """(key, type, description) of every key of a part of a schema, in its order."""
    for key, value in part.get("properties", {}).items():
        items = value.get("items", {})
        name = value.get("$ref", items.get("$ref", "")).rsplit("/", 1)[-1]  # of the part that the key refers to
        shared = schema["$defs"].get(name, {}) if "$ref" in value else {}
        described = {**shared, **value}
        if not value.get("description"):
            raise Wrong(f"{schema['title']}: {path}{key} has no description")
        if "enum" in described:
            kind = "one of " + code(described["enum"])
        elif "const" in described:
            kind = f"`{described['const']}`"
        elif "oneOf" in described:
            parts = [schema["$defs"].get(choice.get("$ref", "").rsplit("/", 1)[-1], choice) for choice in described["oneOf"]]
            kind = " or ".join(part["type"] for part in parts)
        else:
            kind = described.get("type", "object")
            kind = " or ".join(kind) if isinstance(kind, list) else kind
        meaning = value["description"]
        if name.endswith(".json"):
            meaning += f" ([{name}](#{name.replace('.', '')}))"
        elif schema["$defs"].get(name, {}).get("properties"):
            meaning += f" ([{name}](#{name}))"
        elif name and shared.get("description") and "enum" not in shared:
            meaning += f". {shared['description'].rstrip('.')}"
        yield [f"`{path}{key}`", kind, meaning]
        if not name:
            yield from schema_rows(schema, items or value, f"{path}{key}" + ("[]." if items else "."))


def schema_tables(_):
    """One table for each schema, and one for each part that several keys have."""
    heads, parts, shared = ["key", "type", "meaning"], [], {}
    for path in sorted((ROOT / "schemas").glob("*.json")):
        if path.stem == "solution_npz":
            continue
        schema = json.loads(path.read_text(encoding="utf-8"))
        parts.append(f"### {path.name}\n\n{schema['title']}.\n\n{table(heads, schema_rows(schema, schema))}")
        for name, part in schema["$defs"].items():
            if part.get("properties"):
                if shared.setdefault(name, (part, schema))[0] != part:
                    raise Wrong(f"{path.name}: {name} differs from that of another schema")
    parts += [f"### {name}\n\n{part['description']}\n\n{table(heads, schema_rows(schema, part))}"
              for name, (part, schema) in sorted(shared.items())]
    return "\n\n".join(parts)


def npz_arrays(_):
    schema = json.loads((ROOT / "schemas" / "solution_npz.json").read_text(encoding="utf-8"))
    return table(["array", "shape", "type", "meaning"],
                 [[f"`{name}`", f"({', '.join(map(str, array['shape']))}{',' if len(array['shape']) == 1 else ''})", array["type"],
                   array["description"]] for name, array in schema["arrays"].items()])


TABLES = {
    "verdicts": grouped_verdicts,
    "all verdicts": all_verdicts,
    "models": lambda programs: features(programs, "contact", MODEL_FEATURES),
    "solvers": lambda programs: features(programs, "solver", SOLVER_FEATURES),
    "keys": scene_keys,
    "flags": flag_tables,
    "options": options,
    "schemas": schema_tables,
    "arrays": npz_arrays,
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build" / "release")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("names", nargs="*", choices=[*TABLES, []])
    arguments = parser.parse_args()
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    stale, written = [], set()
    with tempfile.TemporaryDirectory() as folder:
        programs = Programs(arguments.build.resolve(), pathlib.Path(folder))

        def replaced(match):
            name = match[2]
            if arguments.names and name not in arguments.names:
                return match[0]
            written.add(name)
            return f"{match[1]}\n{TABLES[name](programs)}\n\n{match[3]}"

        for page in pages:
            shown = page.read_text(encoding="utf-8")
            now = MARK.sub(replaced, shown)
            if now == shown:
                continue
            if not arguments.check:
                page.write_text(now, encoding="utf-8")
                continue
            lines = zip(shown.splitlines() + ["(end)"], now.splitlines() + ["(end)"])
            k, (has, is_now) = next((k, pair) for k, pair in enumerate(lines) if pair[0] != pair[1])
            stale.append(f"{page.relative_to(ROOT)}:{k + 1}: run scripts/reference.py\n  has {has}\n  now {is_now}")
    if missing := set(arguments.names or TABLES) - written:
        stale.append(f"no page has the tables {', '.join(sorted(missing))}")
    print("\n".join(stale))
    return 1 if stale else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Wrong as wrong:
        print(f"reference: {wrong}")
        sys.exit(1)
