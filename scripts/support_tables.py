#!/usr/bin/env python3
"""Writes docs/reference/support.md: which contact models and solvers take which features, and the flags of each program.

usage: scripts/support_tables.py [--build=build/release] [--check]     --check: only says whether the page is up to date

The answers are those of the programs: each feature is a small scene, and a model or solver takes the feature if it does not
answer "not_applicable".
"""

import argparse
import json
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "support.md"
PROGRAMS = ["saltus_audit", "saltus_solve", "saltus_sweep", "saltus_identify", "saltus_scene", "saltus_simulate",
            "saltus_replay", "saltus_reproduce"]


def scene(contact="{}", control="{bodies: [a], initial: [[2, 0.1]]}", a="", b="", objective="", top="", optimize="control"):
    """Two discs, of which the first meets the second."""
    control = f"control: {control}\n" if optimize == "control" else ""
    effort = "  effort: 0.1\n" if optimize == "control" else ""
    return (f"name: probe\nduration: 1\nsteps: 24\noptimize: {optimize}\ncontact: {contact}\n{control}{top}"
            f"bodies:\n  - {{name: a, radius: 0.1, mass: 1, position: [-0.5, 0], velocity: [0.5, 0]{a}}}\n"
            f"  - {{name: b, radius: 0.1, mass: 1, position: [0, 0.02]{b}}}\n"
            "objective:\n  terminal:\n    - {body: b, quantity: position, target: [1, 0.2]" + objective + "}\n" + effort)


SPIN = ", inertia: solid"
MODEL_FEATURES = {
    "friction": scene("{friction: 0.2}"),
    "discs that spin": scene(a=SPIN, b=SPIN),
    "friction and spin": scene("{friction: 0.2}", a=SPIN, b=SPIN),
    "torques": scene(control="{bodies: [a], torque: [a], initial: [[2, 0.1, 0]]}", a=SPIN, b=SPIN),
    "segments, polygons, arcs": scene(top="segments: [{name: gate, from: [2, -1], to: [2, 1]}]\n"),
    "table": scene(control="", top="table: {friction: 0.1, gravity: 9.81}\n", optimize="velocity"),
    "pockets": scene(control="", top="pockets: [{name: hole, position: [3, 0], radius: 0.05}]\n", optimize="velocity"),
}
SOLVER_FEATURES = {
    "control": scene(),
    "launch velocity": scene(optimize="velocity"),
    "friction": scene("{friction: 0.2}"),
    "discs that spin": MODEL_FEATURES["discs that spin"],
    "segments": MODEL_FEATURES["segments, polygons, arcs"],
    "table": MODEL_FEATURES["table"],
    "pockets": MODEL_FEATURES["pockets"],
    "linear term": scene().replace("target: [1, 0.2]", "component: x"),
    "bounds": scene(control="{bodies: [a], initial: [[2, 0.1]], max: 5}"),
    "terminal equality constraint": scene(objective=", hard: true"),
    "running cost": scene() + "  running:\n    - {body: a, quantity: position, target: [[0, 0, 0]], weight: 0.1}\n",
    "waypoint cost": scene() + "  via:\n    - {body: a, time: 0.2, quantity: position, target: [0, 0], weight: 0.1}\n",
    "free duration": scene() + "  duration: {free: true, min: 0.5, max: 2, weight: 0.1}\n",
    "`no_contact`": scene(top="no_contact: [[a, post]]\n").replace("objective:",
        "  - {name: post, radius: 0.1, fixed: true, position: [3, 3]}\nobjective:"),
}


def run(build, program, *flags):
    done = subprocess.run([build / "bin" / program, *flags], text=True, capture_output=True, check=False,
                          env={"COLUMNS": "100", "PATH": "/usr/bin:/bin"})
    if done.returncode not in (0, 1):
        raise SystemExit(f"support_tables: {program} {' '.join(map(str, flags))}: {done.stderr}")
    return done.stdout


def support(build, features, key, flags):
    """{name: {feature: whether it is taken}}"""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for feature, text in features.items():
            path = pathlib.Path(folder) / "probe.yaml"
            path.write_text(text, encoding="utf-8")
            for item in json.loads(run(build, "saltus_solve", f"--scene={path}", "--json", "--progress=none", *flags))["runs"]:
                found.setdefault(item[key], {})[feature] = item["termination"] != "not_applicable"
    return found


def table(first, rows, features):
    lines = ["| " + " | ".join([first, *features]) + " |", "|---" * (len(features) + 1) + "|"]
    lines += ["| " + " | ".join([f"`{name}`", *("yes" if taken[f] else "" for f in features)]) + " |"
              for name, taken in rows.items()]
    return "\n".join(lines)


def page(build):
    models = support(build, MODEL_FEATURES, "contact", ["--contact=all", "--solver=none"])
    solvers = support(build, SOLVER_FEATURES, "solver", ["--contact=event", "--solver=all", "--iterations=1"])
    flags = "\n".join(f"### {program}\n\n```text\n{re.sub(chr(10) + '{3,}', chr(10) * 2, run(build, program, '-h')).rstrip()}\n```\n"
                      for program in PROGRAMS)
    return f"""# What supports what

`scripts/support_tables.py` writes this page from the answers of the programs; a test fails if it is out of date.

## Contact models

A contact model that does not support a feature refuses the scene and gives the reason (`not_applicable`).

{table("contact model", models, MODEL_FEATURES)}

## Solvers

All solvers are run with `--contact=event`, on a scene in which one disc meets another.

{table("solver", solvers, SOLVER_FEATURES)}

`grid_optimum` has a closed form for one objective only, of which these scenes are not all.

## Flags

{flags.rstrip()}
"""


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build" / "release")
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    text = page(arguments.build.resolve())
    if not arguments.check:
        PAGE.write_text(text, encoding="utf-8")
        return 0
    for k, (shown, now) in enumerate(zip(PAGE.read_text(encoding="utf-8").splitlines() + ["(end)"], text.splitlines() + ["(end)"])):
        if shown != now:
            print(f"{PAGE.name}:{k + 1}: run scripts/support_tables.py\n  has {shown}\n  now {now}")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
