#!/usr/bin/env python3
"""Runs the programs as somebody would who wants to break them, and writes down every run that ends as it must not.

    hostile_runs.py --bin=build/release/bin --runs=2000 --seed=1 [--jobs=2] [--keep=DIR] [--only=N]

Run N of a seed is always the same: a scene of the source tree with mutated text, random flags, strange files, or limits
of memory, of files and of time. A run violates what the documentation promises, if

  - it is ended by a signal (an abort, a crash) that this script did not send;
  - it has used 60 s of CPU time (--hang), or ten times as long by the clock; or, if it has huge counts, it is at work as
    long after an interrupt;
  - it has another exit code than 0, 1 or 2;
  - it ends with 0 without an answer: nothing on standard output, JSON that cannot be read, or no page;
  - it ends with 1 or 2 without a word on standard error;
  - it prints or writes NaN or infinity as an answer;
  - it leaves a file that is cut off, or a temporary one.

Each violation is printed with its command; --keep has its folder. The exit code is 1 if there are any.
"""
import argparse
import concurrent.futures
import json
import os
import random
import re
import resource
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time

PROBLEMS = ["bounce_once", "ground_wall", "two_balls", "single_collision", "multiple_collisions", "back_spin", "bank_shot",
            "carrom_gate", "carrom_pot"]
CONTACTS = ["event", "direct", "direct_toi", "lcp", "convex", "convex_toi", "compliant_warp", "compliant_brax", "pbd_warp",
            "pbd_brax", "toi_velocity", "lcp_kkt", "lcp_pgs", "lcp_pgs_adjoint", "ncp", "ncp_restitution", "soft_convex",
            "qcqp", "smooth_compliant", "ipc_barrier", "xpbd", "position_qp", "primal_descent", "dual_descent",
            "static_lcp"]
SOLVERS = ["gd", "ceres_lbfgs", "ceres_lm", "ceres_shooting", "ceres_lagrangian", "ceres_event", "ceres_phases", "hmp",
           "mode_search", "grid_optimum", "none"]
# What a number of a scene or a flag is replaced by.
NUMBERS = ["0", "-0.0", "1", "-1", "0.5", "2", "1e-3", "1e3", "1e-6", "1e6", "1e-9", "1e9", "1e-15", "1e15", "1e-18", "1e18",
           "1e24", "1e-24", "1e-100", "1e100", "1e-150", "1e150", "1e-300", "1e300", "-1e300", "1.7976931348623157e308",
           "5e-324", "2.2250738585072014e-308", "1e999", "-1e999", ".nan", ".inf", "-.inf", "nan", "inf", "0x10", "1_000",
           "0.1.2", "1e", "", "~", "true", "[]", "{}", "[1, 2, 3]", "'text'", "9007199254740993", "18446744073709551616",
           "0.30000000000000004", "0.9999999999999999"]
COUNTS = ["0", "-1", "1", "2", "3", "7", "1000", "2147483647", "2147483648", "-2147483649", "4294967296", "10000000",
          "10000001", "1e5", "9223372036854775808", "1000000"]
TEXTS = ["", "x", "striker", "target", "position", "velocity", "control", "none", "a b", "Ü", "'\\0'", '"\\x00"', "&a", "*a",
         "!!binary aaaa", "|", ">", "x" * 5000, "../../etc", "<script>", "%s%n", "event", "list", "all"]

SCENES = {
    "spin": """
name: hostile_spin
duration: 0.8
steps: 40
gravity: [0, -9.81]
bodies:
  - {name: ball, radius: 0.1, mass: 1, inertia: solid, position: [0, 0.5], velocity: [1, 0], angle: 0.1, angular_velocity: 5}
  - {name: post, radius: 0.2, fixed: true, position: [1, 0.2]}
planes: [{name: ground, point: [0, 0], normal: [0, 1]}]
contact: {restitution: 0.6, friction: 0.3, stiffness: 1.0e4, damping: 1.0}
control: {bodies: [ball], torque: [ball], initial: [[0.5, 0.1, 0.02]], max: 3.0, max_torque: 0.2}
objective:
  terminal:
    - {body: ball, quantity: position, target: [0.4, 0.3], weight: 1.0}
    - {body: ball, quantity: angular_velocity, target: 1.0, weight: 0.1}
  effort: 0.1
optimize: control
""",
    "edges": """
name: hostile_edges
duration: 1.0
steps: 40
gravity: [0, -9.81]
bodies:
  - {name: ball, radius: 0.1, mass: 1, position: [0, 1], velocity: [0.7, 0]}
  - {name: other, radius: 0.12, mass: 0.5, position: [0.5, 1.2], velocity: [-0.7, 0]}
segments: [{name: gate, from: [-1, 0], to: [0.3, 0.1]}, {name: wall, from: [0.3, 0.1], to: [2, 0]}]
polygons: [{name: box, points: [[1, 0.3], [1.4, 0.3], [1.4, 0.7], [1, 0.7]], solid: inside}]
arcs: [{name: bowl, center: [0, 3], radius: 2.5, from: 3.5, to: 5.9}]
contact: {restitution: 0.5}
objective: {terminal: [{body: ball, quantity: velocity, target: [0, 0], weight: 1.0}]}
optimize: velocity
free: [ball]
""",
    "table": """
name: hostile_table
duration: 2.0
steps: 40
table: {friction: 0.1, gravity: 9.81}
bodies:
  - {name: cue, radius: 0.03, mass: 0.2, position: [0, 0], velocity: [1.5, 0.05]}
  - {name: coin, radius: 0.03, mass: 0.2, position: [0.4, 0.02]}
planes: [{name: cushion, point: [0.9, 0], normal: [-1, 0]}]
pockets: [{name: hole, position: [0.8, 0.2], radius: 0.05}]
contact: {restitution: 0.9}
objective: {terminal: [{body: coin, quantity: position, target: [0.8, 0.2], weight: 1.0}]}
optimize: velocity
""",
    "constrained": """
name: hostile_constrained
duration: 1.0
steps: 30
bodies:
  - {name: striker, radius: 0.2, mass: 1.0, position: [-2, -2]}
  - {name: target, radius: 0.2, mass: 1.0, position: [-1, -1]}
  - {name: post, radius: 0.1, fixed: true, position: [1, -2]}
contact: {restitution: 1.0}
control: {bodies: [striker], initial: [[3, 3]], max: 8}
objective:
  terminal: [{body: target, quantity: position, target: [0, 0], hard: true}]
  running: [{body: striker, quantity: position, target: [[0, -2, -2], [1, -1, -1]], weight: 0.1}]
  via: [{body: striker, time: 0.3, quantity: position, target: [-1.8, -1.8], weight: 1.0}]
  effort: 0.1
  duration: {free: true, min: 0.5, max: 3, weight: 0.5}
no_contact: [[striker, post]]
optimize: control
""",
    "rest": """
name: hostile_rest
duration: 0.5
steps: 20
gravity: [0, -10]
bodies:
  - {name: lower, radius: 0.1, mass: 1, position: [0, 0.1]}
  - {name: upper, radius: 0.1, mass: 1, position: [0, 0.3]}
planes: [{name: ground, point: [0, 0], normal: [0, 1]}]
contact: {restitution: 0.0, friction: 0.4}
objective: {terminal: [{body: upper, quantity: position, component: y, weight: 1.0}]}
optimize: position
""",
    "at_once": """
name: hostile_at_once
duration: 1.0
steps: 16
bodies:
  - {name: left, radius: 0.25, mass: 1, position: [-1, 0], velocity: [2, 0]}
  - {name: middle, radius: 0.25, mass: 1, position: [0, 0]}
  - {name: right, radius: 0.25, mass: 1, position: [1, 0], velocity: [-2, 0]}
contact: {restitution: 1.0}
objective: {terminal: [{body: middle, quantity: position, target: [0.1, 0], weight: 1.0}]}
optimize: velocity
""",
}

RECORDING = "time,body,x,y,sigma\n" + "".join(
    f"{k / 30:.6f},ball,{0.4 * k / 30:.6f},{abs(1 - 4.9 * (k / 30) ** 2) % 1:.6f},0.01\n" for k in range(20))
BOUNCE = """
name: hostile_bounce
duration: 1.0
steps: 60
gravity: [0, -9.81]
bodies: [{name: ball, radius: 0.05, mass: 0.3, position: [0, 1], velocity: [0.4, 0]}]
planes: [{name: floor, point: [0, 0], normal: [0, 1]}]
contact: {restitution: 0.5}
objective: {terminal: [{body: ball, quantity: position, target: [0, 0], weight: 1.0}]}
optimize: none
"""
MOTION = {"bodies": [{"name": "ball", "radius": 0.2}],
          "planes": [{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
          "times": [0, 0.1, 0.2], "states": [[[0, 1, 2, 0]], [[0.2, 1, 2, 0]], [[0.4, 1, 2, 0]]],
          "touches": [{"a": "ball", "b": "ground", "begin": 0.1}]}
SIMULATOR = """import json, math, sys
for line in sys.stdin:
    q = json.loads(line)
    if 'saltus' in q: print('{"name": "hostile"}', flush=True); continue
    s = q['simulate']; h = s['duration'] / s['steps']; x = [list(b) for b in s['initial']]
    for b in x:
        b[0] += s['duration'] * b[2]; b[1] += s['duration'] * b[3]
    %s
    print(json.dumps({'id': q['id'], 'final': x}), flush=True)
"""
MISBEHAVIOUR = ["pass", "sys.exit(3)", "x[0][0] = float('nan')", "x[0][0] = 1e308 * 10", "x = []", "print('noise', flush=True)",
                "q['id'] = -1", "x[0][0] = 'text'", "os.abort() if False else sys.exit(0)", "x[0][0] = 1e300", "x *= 1000",
                "print('y' * 100000, flush=True)", "sys.stderr.write('\\0' * 1000)", "sys.stdout.close(); sys.exit(0)"]


class Run:
    """What is to be run: a command in a folder of its own, and how."""

    def __init__(self, folder):
        self.folder = folder
        self.command = []
        self.kind = ""
        self.stdin = b""
        self.stdout = None  # a path, instead of a file
        self.limits = {resource.RLIMIT_AS: 3 << 30, resource.RLIMIT_CORE: 0}
        self.closed = []  # standard streams
        self.interrupt_at = None  # s
        self.huge = False  # so that it may take as long as it likes until it is interrupted
        self.page = None  # that the program writes
        self.output = None  # the folder for its files

    def write(self, name, text):
        path = os.path.join(self.folder, name)
        with open(path, "wb") as file:
            file.write(text if isinstance(text, bytes) else text.encode("utf-8", "surrogateescape"))
        return path


# ----------------------------------------------------------------------------------------------------------------------
# Mutations of text


def mutate_scene(rng, text, times):
    for _ in range(times):
        text = rng.choice([number, number, number, number, count, drop_line, double_line, swap_lines, drop_key, rename_key,
                           word, byte, cut, type_of])(rng, text)
    return text


def replace_one(rng, pattern, text, value):
    places = list(re.finditer(pattern, text))
    if not places:
        return text
    at = rng.choice(places)
    return text[:at.start()] + value + text[at.end():]


NUMBER = r"(?<![A-Za-z_0-9.])[-+]?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?(?![A-Za-z_0-9])"


def random_number(rng):
    if rng.random() < 0.4:
        return f"{rng.choice(['', '-'])}{rng.uniform(1, 10):.17g}e{rng.randint(-300, 300)}"
    return rng.choice(NUMBERS)


def number(rng, text):
    """Most scenes with a number that is far off are refused, so half of the numbers are such as somebody may mean."""
    places = list(re.finditer(NUMBER, text))
    if not places:
        return text
    at = rng.choice(places)
    value = random_number(rng)
    if rng.random() < 0.5:
        value = f"{float(at.group()) * rng.choice([-1, 0, 0.5, 0.99, 1 + 1e-15, 2, 10, 0.1, 1000, 1e-3]):.17g}"
    return text[:at.start()] + value + text[at.end():]


def count(rng, text):
    return re.sub(r"steps: *\S+", "steps: " + rng.choice(COUNTS), text, count=1)


def type_of(rng, text):
    return replace_one(rng, r"\[[^\[\]]*\]|\{[^{}]*\}", text, rng.choice(["[]", "{}", "0", "text", "[[]]", "null", "[1, 2, 3, 4, 5]"]))


def drop_line(rng, text):
    lines = text.split("\n")
    lines.pop(rng.randrange(len(lines)))
    return "\n".join(lines)


def double_line(rng, text):
    lines = text.split("\n")
    at = rng.randrange(len(lines))
    lines.insert(at, lines[at])
    return "\n".join(lines)


def swap_lines(rng, text):
    lines = text.split("\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return "\n".join(lines)


def drop_key(rng, text):
    return replace_one(rng, r"[a-z_]+: *[^,{}\[\]\n]+,?", text, "")


def rename_key(rng, text):
    return replace_one(rng, r"[a-z_]+(?=:)", text, rng.choice(["name", "radius", "mass", "x", "weight", "target", "velocity", "fixed", "inertia", "table"]))


def word(rng, text):
    return replace_one(rng, r"(?<=: )[a-z_]+", text, rng.choice(TEXTS))


def byte(rng, text):
    raw = bytearray(text.encode("utf-8", "surrogateescape"))
    if raw:
        raw[rng.randrange(len(raw))] = rng.randrange(256)
    return raw.decode("utf-8", "surrogateescape")


def cut(rng, text):
    return text[:rng.randrange(len(text) + 1)] if rng.random() < 0.3 else text


# ----------------------------------------------------------------------------------------------------------------------
# Kinds of runs


class Maker:
    def __init__(self, options):
        self.bin = os.path.abspath(options.bin)
        self.texts = dict(SCENES)
        for folder in ("problems", "engines/scenes"):
            full = os.path.join(options.source, folder)
            for name in sorted(os.listdir(full)):
                if name.endswith(".yaml"):
                    with open(os.path.join(full, name), encoding="utf-8") as file:
                        self.texts[name] = file.read()

    def program(self, name):
        return os.path.join(self.bin, name)

    def any_scene(self, rng, run, few_steps=True):
        text = self.texts[rng.choice(sorted(self.texts))]
        if few_steps:
            text = re.sub(r"(?m)^steps: *[0-9]+", f"steps: {rng.choice([6, 12, 20, 24, 40, 60])}", text)
        return text

    def some(self, rng, names, most=2):
        return ",".join(rng.sample(names, rng.randint(1, most)))

    def common(self, rng, run, of_files=0.35):
        flags = ["--threads=" + rng.choice(["1", "2", "0", "3"]), "--progress=" + rng.choice(["none", "none", "plain"])]
        if rng.random() < 0.4:
            flags.append("--json")
        if rng.random() < of_files:
            run.output = os.path.join(run.folder, "out")
            flags.append("--output_dir=" + run.output)
        return flags

    def audit(self, rng, run, scene):
        return [self.program("saltus_audit"), "--scene=" + scene, "--contact=" + self.some(rng, CONTACTS)] + \
            self.common(rng, run) + (["--attribution_seconds=2"] if rng.random() < 0.5 else []) + \
            (["--width_sweep"] if rng.random() < 0.1 else [])

    def solve(self, rng, run, scene):
        flags = self.common(rng, run)
        if "--json" in flags and rng.random() < 0.5:
            flags.append("--states")
        return [self.program("saltus_solve"), "--scene=" + scene, "--contact=" + self.some(rng, ["event"] * 8 + CONTACTS, 1),
                "--solver=" + rng.choice(SOLVERS), "--iterations=" + rng.choice(["0", "1", "5", "30"]),
                "--search_seconds=2"] + flags

    def sweep(self, rng, run, scene):
        points = rng.choice(["steps=5,10", "restitution=0:1:lin:3", "stiffness=1e2:1e4:log:3", "friction=0,0.5 & damping=0,1",
                             "(contact,steps)=(event,7),(direct,8)", "duration=0.1,0.2", "gravity_y=-10,10", "precision=float,double"])
        solver = rng.choice(["none", "none", "gd", "ceres_lm"])
        return [self.program("saltus_sweep"), "--scene=" + scene, "--contact=" + self.some(rng, CONTACTS), "--sweep=" + points,
                "--solver=" + solver, "--iterations=3", "--point_seconds=5"] + self.common(rng, run)

    def any_command(self, rng, run, scene):
        return rng.choice([self.audit, self.audit, self.solve, self.solve, self.sweep])(rng, run, scene)

    # A scene whose text is mutated.
    def mutated(self, rng, run):
        text = mutate_scene(rng, self.any_scene(rng, run), rng.choice([1, 1, 1, 2, 3, 6]))
        steps = re.search(r"steps: *([0-9]+)", text)
        run.huge = bool(steps) and float(steps.group(1)) > 5000
        run.command = self.any_command(rng, run, run.write("scene.yaml", text))

    # Flags with values that are none.
    def flags(self, rng, run):
        name = rng.choice(PROBLEMS + ["saltus_audit", "saltus_solve", "saltus_sweep", "saltus_scene", "saltus_replay",
                                      "saltus_identify", "saltus_simulate", "saltus_reproduce"])
        scene = run.write("scene.yaml", self.any_scene(rng, run))
        values = {
            "contact": lambda: rng.choice(["", ",", "all", "list", "x", "ncp:kappa=", "ncp:kappa=1e-6:kappa=2", "ncp:kappa=nan", "xpbd:substeps=1e9",
                                           "xpbd:substeps=-1", "direct:x=1", "event,event", self.some(rng, CONTACTS, 3)]),
            "solver": lambda: rng.choice(["", ",", "none", "list", "x", "gd,,gd", self.some(rng, SOLVERS, 3)]),
            "steps": lambda: rng.choice(["10", "20"] + COUNTS[:6] + ["nan", "1e3", "2147483648"]),
            "restitution": lambda: random_number(rng), "friction": lambda: random_number(rng),
            "stiffness": lambda: random_number(rng), "damping": lambda: random_number(rng),
            "learning_rate": lambda: random_number(rng), "iterations": lambda: rng.choice(["0", "1", "-1", "10", "x"]),
            "precision": lambda: rng.choice(["float", "double", "half", ""]),
            "sequence": lambda: rng.choice(["auto", "fixed", "none", "", "a-b", "striker-target", "striker-target," * 50, "-", ",,"]),
            "threads": lambda: rng.choice(["0", "1", "2", "-1", "5000", "x"]),
            "memory_limit": lambda: rng.choice(["1", "0", "-1", "2147483647", "10"]),
            "surrogate": lambda: rng.choice(["list", "smoothed_first", "smoothed_zeroth", "complementarity_aware", "x"]),
            "surrogate_sigma": lambda: random_number(rng), "surrogate_samples": lambda: rng.choice(["1", "2", "0", "-5", "10"]),
            "surrogate_segments": lambda: rng.choice(["1", "0", "-1", "1000", "3"]),
            "search_seconds": lambda: rng.choice(["0.5", "-1", "nan", "1e-9"]), "search_starts": lambda: rng.choice(["0", "1", "-1"]),
            "search_memory": lambda: rng.choice(["0", "1", "-1"]), "search_seed": lambda: rng.choice(["0", "-1", "99999999999999999999"]),
            "attribution_seconds": lambda: rng.choice(["1", "-1", "nan", "1e-9"]), "width_sweep": lambda: rng.choice(["true", "x"]),
            "states": lambda: "true", "json": lambda: "true", "progress": lambda: rng.choice(["plain", "auto", "x", ""]),
            "rate_per_time": lambda: "true", "seed": lambda: rng.choice(["0", "-1", "7", "9223372036854775807"]),
            "discs": lambda: rng.choice(["0", "1", "2", "30", "-1", "1000", "100000"]), "kind": lambda: rng.choice(["gas", "pile", "break", "control", "x"]),
            "sweep": lambda: rng.choice(["steps=5,10", "steps=", "x=1", "steps=1:2", "steps=1:10:log:0", "steps=1:10:lin:1000000000", "(a", ";;;",
                                         "steps=5;steps=6", "stiffness=1:0:log:3", "restitution=nan", "seed=0:2:lin:3", "@/dev/null", "contact=event:x=1",
                                         "steps=5,10;" * 40, "restitution=1e-300:1e300:log:3"]),
            "offer": lambda: rng.choice(["none", "gradient", "x", ""]), "unknown": lambda: rng.choice(["restitution", "", "mass.x", "force.ball.z", "gravity"]),
            "segment": lambda: rng.choice(["1e-9", "-1", "nan", "0.1"]), "starts": lambda: rng.choice(["0", "1", "-1"]),
            "law": lambda: rng.choice(["network", "network:0", "network:99999", "impulse:2", "x"]), "events": lambda: rng.choice(["affine", "profile:2", "x"]),
            "loss": lambda: rng.choice(["none", "cauchy", "x"]), "loss_scale": lambda: random_number(rng),
            "shard": lambda: rng.choice(["1/2", "0/1", "3/2", "x", "1/99999999999"]), "retry_failed": lambda: "true",
            "point_seconds": lambda: rng.choice(["1", "-1", "nan"]), "no_such_flag": lambda: "1", "flagfile": lambda: "/nonexistent",
            "fromenv": lambda: "steps", "minloglevel": lambda: "4", "v": lambda: "0", "undefok": lambda: "x",
        }
        flags = {"progress": "none"} if name not in ("saltus_scene", "saltus_replay", "saltus_simulate") else {}
        if name in ("saltus_audit", "saltus_solve", "saltus_sweep", "saltus_identify"):
            flags["scene"] = scene
        if name in PROBLEMS + ["saltus_audit", "saltus_solve", "saltus_sweep"]:
            flags.update(steps="20", contact="event")
        if name in PROBLEMS + ["saltus_solve", "saltus_sweep"]:
            flags.update(solver=rng.choice(["none", "gd"]), iterations="3", search_seconds="1")
        if name == "saltus_sweep":
            flags["sweep"] = "steps=5,10"
        if name == "saltus_identify":
            flags.update(scene=run.write("bounce.yaml", BOUNCE), recording=run.write("recording.csv", RECORDING), starts="2")
        if name == "saltus_simulate":
            flags["contact"] = "event"
        if name == "saltus_reproduce":
            flags.update({"problems_dir": "/nonexistent"})
        for key in rng.sample(sorted(values), rng.randint(1, 3)):
            flags[key] = values[key]()
        if flags.get("contact") == "all":
            flags["solver" if "solver" in flags else "contact"] = "none" if "solver" in flags else "event,direct"
        run.huge = True  # many threads, many substeps
        run.command = [self.program(name)] + [f"--{key}={value}" for key, value in flags.items()]
        if rng.random() < 0.1:
            run.command.append(rng.choice(["-h", "--helpfull", "--version", "--", "x", "-", "--=", "---", "--steps", ""]))

    # Files that are not what they are said to be.
    def files(self, rng, run):
        rng.choice([self.recordings, self.starts, self.given, self.replays, self.simulators, self.places, self.questions])(rng, run)

    def recordings(self, rng, run):
        text = RECORDING
        choice = rng.randrange(5)
        if choice == 0:
            text = "time,body,x,y\n" + "".join(
                f"{rng.uniform(0, 1):.6f},ball,{rng.gauss(0, 1):.6f},{rng.gauss(0, 1):.6f}\n" for _ in range(rng.randint(1, 60)))
        elif choice < 4:
            for _ in range(rng.randint(1, 4)):
                text = rng.choice([number, number, byte, cut, drop_line, double_line, swap_lines])(rng, text)
        run.command = [self.program("saltus_identify"), "--scene=" + run.write("scene.yaml", BOUNCE),
                       "--recording=" + run.write("recording.csv", text), "--starts=3",
                       "--unknown=" + rng.choice(["restitution", "restitution,mass.ball", "gravity", "gravity.y,restitution", "force.ball"])]
        if rng.random() < 0.3:
            run.command.append("--segment=" + rng.choice(["1e-9", "0.01", "0.1", "0.3", "1e300"]))
        if rng.random() < 0.2:
            run.command.append("--law=" + rng.choice(["network:1", "impulse:1"]))
            run.command = [flag for flag in run.command if not flag.startswith("--unknown")]
        if rng.random() < 0.2:
            run.command.append("--known_start")
        run.command += self.common(rng, run)

    def garbage(self, rng, text):
        choice = rng.randrange(6)
        if choice == 0:
            return b""
        if choice == 1:
            return bytes(rng.randrange(256) for _ in range(rng.choice([1, 10, 1000])))
        if choice == 2:
            return ("[" * rng.choice([10, 1000, 100000])).encode()
        if choice == 3:
            return json.dumps(rng.choice([None, 1, "x", [], {}, [[]], {"control": 1}, {"control": []}, {"times": []}])).encode()
        for _ in range(rng.randint(1, 3)):
            text = rng.choice([number, number, byte, cut, type_of])(rng, text)
        return text.encode("utf-8", "surrogateescape")

    def starts(self, rng, run):
        text = json.dumps({"control": [[[3.0, 3.0]]] * 20, "durations": [0.05] * 20, "velocity": {"striker": [1, 1]},
                           "position": {"striker": [-2, -2]}})
        path = run.write("start." + rng.choice(["json", "npz", "txt"]), self.garbage(rng, text))
        run.command = [self.program("saltus_solve"), "--scene=" + run.write("scene.yaml", self.texts["two_balls.yaml"]), "--steps=20",
                       "--contact=event", "--solver=" + rng.choice(["none", "gd", "ceres_lm"]), "--iterations=3",
                       rng.choice(["--control=", "--warm_start="]) + path] + self.common(rng, run)

    def given(self, rng, run):
        text = json.dumps({"contact": "mine", "gradient": {"position": {"striker": [1.0, 2.0], "target": [0.5, 0.25]},
                                                           "velocity": {"striker": [1.0, 2.0], "target": [0.5, 0.25]}}})
        run.command = [self.program("saltus_audit"), "--scene=" + run.write("scene.yaml", self.texts["two_balls.yaml"]), "--steps=20",
                       "--contact=event", "--given=" + run.write("given.json", self.garbage(rng, text))] + self.common(rng, run)

    def replays(self, rng, run):
        paths = [run.write(f"motion{i}." + rng.choice(["json", "json", "npz"]), self.garbage(rng, json.dumps(MOTION)) if rng.random() < 0.8
                           else json.dumps(MOTION)) for i in range(rng.randint(1, 2))]
        run.page = os.path.join(run.folder, "page.html")
        run.command = [self.program("saltus_replay")] + paths + ["--output=" + run.page]

    def simulators(self, rng, run):
        path = run.write("simulator.py", SIMULATOR.replace("%s", rng.choice(MISBEHAVIOUR)))
        command = rng.choice([f"python3 {path}"] * 8 + ["true", "false", "cat", "/nonexistent", "yes", "sleep 100", "exit 3"])
        name = rng.choice(["", "mine=", "direct=", "event="])
        run.huge = True  # differences of many widths
        run.command = [self.program("saltus_audit"), "--scene=" + run.write("scene.yaml", self.texts["two_balls.yaml"]), "--steps=8",
                       f"--simulate={name}{command}", "--simulate_seconds=" + rng.choice(["2", "5"])] + self.common(rng, run, 0.6)
        if rng.random() < 0.3:
            run.command.append("--contact=direct")

    # Where files are to be written.
    def places(self, rng, run):
        scene = run.write("scene.yaml", self.any_scene(rng, run))
        run.command = [flag for flag in self.any_command(rng, run, scene) if not flag.startswith("--output_dir")]
        place = os.path.join(run.folder, "place")
        run.output = None
        choice = rng.randrange(8)
        if choice == 0:
            run.write("place", "a file")
        elif choice == 1:
            os.symlink(os.path.join(run.folder, "nowhere"), place)
        elif choice == 2:
            place = rng.choice(["/proc", "/proc/self/fd", "/dev/null", "/dev/full", "/sys", "", "/nonexistent/\0x".replace("\0", "0"), "x" * 5000])
        elif choice == 3:
            os.mkfifo(place)
        else:
            # The folder is there, and full of what is no regular file.
            os.mkdir(place)
            elsewhere = os.path.join(run.folder, "elsewhere")
            os.mkdir(elsewhere)
            for name in ["report.html", "sweep.csv", "sweep.npz", "sweep.study.json"]:
                at = os.path.join(place, name)
                kind = rng.randrange(4)
                if kind == 0:
                    os.mkdir(at)
                elif kind == 1:
                    os.symlink(os.path.join(elsewhere, name), at)
                elif kind == 2:
                    os.symlink("/dev/full", at)
                elif kind == 3:
                    os.symlink(name, at)
        run.command.append("--output_dir=" + place)

    def questions(self, rng, run):
        scene = {"bodies": [{"name": "a", "radius": 0.2, "mass": 1.0}]}
        lines = [json.dumps({"saltus": 1, "scene": scene})] + [
            json.dumps({"id": i, "simulate": {"steps": rng.choice([1, 5, 0, -1]), "duration": rng.choice([1.0, 0, -1, 1e300]), "initial": [[0, 0, 1, 1]], "control": []}})
            for i in range(3)]
        run.stdin = b"\n".join(self.garbage(rng, line) if rng.random() < 0.6 else line.encode() for line in lines) + b"\n"
        run.command = [self.program("saltus_simulate"), "--contact=" + rng.choice(CONTACTS), "--offer=" + rng.choice(["none", "gradient,step,states"])]

    # Limits, lost streams, interrupts.
    def limits(self, rng, run):
        text = self.any_scene(rng, run)
        choice = rng.randrange(6)
        if choice < 2:
            run.limits[resource.RLIMIT_AS] = rng.choice([256, 300, 400, 512, 700]) << 20
            text = re.sub(r"(?m)^steps: *[0-9]+", f"steps: {rng.choice([1000, 100000, 1000000, 3000000])}", text)
            run.huge = True
        elif choice == 2:
            run.limits[resource.RLIMIT_FSIZE] = rng.choice([0, 1, 4096, 20000])
        elif choice == 3:
            run.limits[resource.RLIMIT_NOFILE] = rng.choice([3, 4, 5, 8, 12])
        elif choice == 4:
            run.closed = rng.sample([0, 1, 2], rng.randint(1, 3))
            if rng.random() < 0.5:
                run.closed, run.stdout = [], "/dev/full"
        else:
            run.interrupt_at = rng.uniform(0.05, 3)
            text = re.sub(r"(?m)^steps: *[0-9]+", f"steps: {rng.choice([100, 3000, 100000])}", text)
            run.huge = True
        run.command = self.any_command(rng, run, run.write("scene.yaml", text))

    def make(self, seed, index, folder):
        rng = random.Random(f"{seed}:{index}")
        run = Run(folder)
        run.kind = rng.choices(["mutated", "flags", "files", "limits"], [50, 20, 18, 12])[0]
        getattr(self, run.kind)(rng, run)
        return run


# ----------------------------------------------------------------------------------------------------------------------
# Running and judging


class Outcome:
    def __init__(self, code, output, errors, seconds, late, interrupted):
        self.code, self.output, self.errors = code, output, errors
        self.seconds, self.late, self.interrupted = seconds, late, interrupted


def cpu_seconds(pid):
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
            fields = file.read().rpartition(")")[2].split()
    except FileNotFoundError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def wait_for(child, seconds):
    """Raises TimeoutExpired after so much CPU time, which a busy machine does not shorten, or ten times as long."""
    start, used = time.monotonic(), cpu_seconds(child.pid)
    while True:
        try:
            return child.wait(min(seconds, 5))
        except subprocess.TimeoutExpired:
            if cpu_seconds(child.pid) - used > seconds or time.monotonic() - start > 10 * seconds:
                raise


def execute(run, hang):
    def prepare():
        os.setsid()
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell that runs this in the background ignores it
        for which, value in run.limits.items():
            resource.setrlimit(which, (value, value))
        for stream in run.closed:
            os.close(stream)

    stdin, stdout, stderr = (os.path.join(run.folder, name) for name in (".stdin", ".stdout", ".stderr"))
    with open(stdin, "wb") as file:
        file.write(run.stdin)
    environment = {**os.environ, "LC_ALL": "C", "COLUMNS": "100"}
    start = time.monotonic()
    with open(stdin, "rb") as to, open(run.stdout or stdout, "wb") as out, open(stderr, "wb") as err:
        child = subprocess.Popen(run.command, stdin=to, stdout=out, stderr=err, cwd=run.folder, env=environment, preexec_fn=prepare)
    late = interrupted = False
    try:
        if run.interrupt_at is not None or run.huge:
            try:
                child.wait(run.interrupt_at if run.interrupt_at is not None else 10)
            except subprocess.TimeoutExpired:
                interrupted = True
                child.send_signal(signal.SIGINT)
        wait_for(child, hang)
    except subprocess.TimeoutExpired:
        late = True
    if late:
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    seconds = time.monotonic() - start
    read = lambda path: open(path, "rb").read().decode("utf-8", "replace") if os.path.isfile(path) else ""
    return Outcome(child.returncode, "" if run.stdout else read(stdout), read(stderr), seconds, late, interrupted)


NO_NUMBER = re.compile(r"(?<![A-Za-z0-9_./'-])[-+]?(?:nan|inf|infinity)(?![A-Za-z0-9_./'-])", re.IGNORECASE)


def no_number(text):
    text = re.sub(r"'\{[^']*'", "''", text)  # the line of a simulator, quoted
    found = NO_NUMBER.search(text)
    return text[max(0, found.start() - 40):found.end() + 40].replace("\n", "\\n") if found else None


def judge_files(run):
    if run.output is None or not os.path.isdir(run.output) or resource.RLIMIT_FSIZE in run.limits:
        return
    for folder, _, names in os.walk(run.output):
        for name in names:
            path = os.path.join(folder, name)
            if not stat.S_ISREG(os.lstat(path).st_mode):
                continue
            if ".partial." in name:
                yield f"a temporary file is left: {name}"
                continue
            data = open(path, "rb").read()
            if name.endswith(".html") and not data.rstrip().endswith(b"</html>"):
                yield f"{name} is cut off"
            if name.endswith((".csv", ".md")) and no_number(data.decode("utf-8", "replace")):
                yield f"{name} has no number: {no_number(data.decode('utf-8', 'replace'))}"
            if name.endswith(".npz") and not data.startswith(b"PK"):
                yield f"{name} is no archive"


def judge(run, outcome, hang):
    """The violations of one run."""
    if outcome.late:
        yield f"at work after {hang:g} s" + (" since an interrupt" if outcome.interrupted else "")
        return
    stopped = outcome.interrupted and outcome.code == -signal.SIGINT  # before it looks for interrupts
    if stopped:
        return
    if outcome.code < 0:
        yield f"ended by signal {-outcome.code}"
        return
    starved = run.limits.get(resource.RLIMIT_NOFILE, 1000) < 6 and outcome.code == 127  # no libraries
    if outcome.code not in (0, 1, 2) and not starved:
        yield f"exit code {outcome.code}"
    mute = 2 in run.closed or run.limits.get(resource.RLIMIT_FSIZE) == 0  # standard error is a file
    if outcome.code != 0 and not outcome.errors.strip() and not mute:
        yield f"exit code {outcome.code}, and not a word on standard error"
    if outcome.code == 0 and not run.stdout and 1 not in run.closed:
        asked = any(line.strip() for line in run.stdin.splitlines()) if "saltus_simulate" in run.command[0] else True
        if asked and not outcome.output.strip():
            yield "exit code 0, and nothing on standard output"
        if run.page and not os.path.isfile(run.page):
            yield "exit code 0, and no page"
        if "--json" in run.command and outcome.output.lstrip().startswith(("{", "[")):
            try:
                json.loads(outcome.output)
            except ValueError as error:
                yield f"JSON that cannot be read: {error}"
    found = no_number(outcome.output)
    if found:
        yield f"standard output has no number: {found}"
    found = no_number(outcome.errors) if outcome.code == 0 else None
    if found:
        yield f"standard error has no number: {found}"
    yield from judge_files(run)


def how_to_repeat(run):
    parts = [f"cd {shlex.quote(run.folder)};"]
    if run.limits.get(resource.RLIMIT_AS, 0) < 3 << 30:
        parts.append(f"ulimit -v {run.limits[resource.RLIMIT_AS] >> 10};")
    if resource.RLIMIT_FSIZE in run.limits:
        parts.append(f"(RLIMIT_FSIZE {run.limits[resource.RLIMIT_FSIZE]})")
    if resource.RLIMIT_NOFILE in run.limits:
        parts.append(f"ulimit -n {run.limits[resource.RLIMIT_NOFILE]};")
    parts += [shlex.quote(part) for part in run.command] + [f"{stream}>&-" for stream in run.closed]
    if run.stdout:
        parts.append(">" + run.stdout)
    if run.interrupt_at is not None:
        parts.append(f"(interrupted after {run.interrupt_at:.2f} s)")
    return " ".join(parts)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    source = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    parser.add_argument("--bin", default=os.path.join(source, "build/release/bin"), help="the folder of the programs")
    parser.add_argument("--source", default=source, help="the source tree, whose scenes are mutated")
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="the number of the first run")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--hang", type=float, default=60, help="s of CPU time, after which a run is said to hang")
    parser.add_argument("--only", type=int, help="the number of one run")
    parser.add_argument("--keep", help="a folder, in which the folders of runs with violations stay")
    options = parser.parse_args()
    maker = Maker(options)
    root = options.keep or tempfile.mkdtemp(prefix="hostile_runs_")
    os.makedirs(root, exist_ok=True)

    def one(index):
        folder = os.path.join(root, f"run_{options.seed}_{index}")
        shutil.rmtree(folder, ignore_errors=True)
        os.makedirs(folder)
        run = maker.make(options.seed, index, folder)
        outcome = execute(run, options.hang)
        violations = list(judge(run, outcome, options.hang))
        if options.only is not None:
            print(how_to_repeat(run), f"exit code {outcome.code}, {outcome.seconds:.1f} s", outcome.output[-3000:], outcome.errors[-3000:], sep="\n")
        elif not (violations and options.keep):
            shutil.rmtree(folder, ignore_errors=True)
        return index, run, outcome, violations

    indices = [options.only] if options.only is not None else range(options.first, options.first + options.runs)
    counts, codes, bad, longest = {}, {}, 0, 0.0
    with concurrent.futures.ThreadPoolExecutor(max(1, options.jobs)) as pool:
        for index, run, outcome, violations in pool.map(one, indices):
            counts[run.kind] = counts.get(run.kind, 0) + 1
            codes[outcome.code] = codes.get(outcome.code, 0) + 1
            if not outcome.interrupted:
                longest = max(longest, outcome.seconds)
            if violations:
                bad += 1
                print(f"run {index} of seed {options.seed} ({run.kind}): {'; '.join(violations)}\n  {how_to_repeat(run)}")
                for line in outcome.errors.strip().splitlines()[-3:]:
                    print("  | " + line[:300])
                sys.stdout.flush()
    if not options.keep and options.only is None:
        shutil.rmtree(root, ignore_errors=True)
    print(f"{len(list(indices))} runs ({', '.join(f'{n} {kind}' for kind, n in sorted(counts.items()))}), exit codes "
          f"{', '.join(f'{code}: {n}' for code, n in sorted(codes.items()))}, longest {longest:.1f} s, {bad} with violations")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
