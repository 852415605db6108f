#!/usr/bin/python3
# usage: engines/tasks.py OUTPUT.csv [--build=DIR] [--audit=FILE] [--tasks=NAME,...] [id...]
#        engines/tasks.py --check [the same]
# Measures the engines that are installed on all tasks, from final states: a row for each engine and task, written as
# soon as it is known; rows that OUTPUT.csv has are not measured again. --check has saltus_audit judge them instead, and
# compares what it says with data/engine_tasks.csv: exit code 1 if one differs, 77 if none of the engines is there.
import argparse
import csv
import json
import pathlib
import shlex
import statistics
import subprocess
import sys

from check import FLOAT32, HERE, command_of, engines, how_to_get
from client import DriverError, NotApplicable, final_states
from verdict import of_gradient, of_motion, relative_error

ROOT = HERE.parent
COMMITTED = ROOT / "data" / "engine_tasks.csv"
# In the order of the table. The scene file of each, what it is, and a wide width: more than what moves in a step. Tasks
# without one are of boxes: saltus_bodies measures them, from single steps.
TASKS = {
    "bounce_once": (ROOT / "problems" / "bounce_once.yaml", "task 1", 1e-2),
    "ground_wall": (ROOT / "problems" / "ground_wall.yaml", "task 2", 5e-2),
    "ground_wall_rough": (HERE / "scenes" / "ground_wall_rough.yaml", "task 2, friction 0.1", 5e-2),
    "two_balls": (ROOT / "problems" / "two_balls.yaml", "task 3", 1e-2),
    "break_of_8": (HERE / "scenes" / "break_of_8.yaml", "break of 8 discs", 1e-2),
    "box": (HERE / "scenes" / "box.yaml", "box tossed at the ground", None),
    "box_rough": (HERE / "scenes" / "box_rough.yaml", "box, friction 0.3", None),
}
COLUMNS = ["id", "task", "loss", "loss_error", "narrow_error", "wide_error", "motion", "verdict", "reason"]
NARROW = {"float64": 1e-6, "float32": 1e-4}
# Step counts: those of the scene times 1, 2, 4, 8, and a few more of each, so that the impacts fall elsewhere in a step.
REFINEMENTS, SAMPLES = (1, 2, 4, 8), (0, 1, 3)
GOOD = ("right", "consistent")
BOX_STEPS = 100


# A task: its scene as saltus has read it, and its exact loss and gradient by the start of the first disc.
class Task:
    def __init__(self, name, program):
        path, self.title, self.wide = TASKS[name]
        done = subprocess.run([program, f"--scene={path}", "--contact=event", "--json", "--progress=none"],
                              capture_output=True, text=True, check=False)
        reference = json.loads(done.stdout)["reference"]
        self.scene = scene_in(path)
        self.initial = [[float(x) for x in (*body["position"], *body.get("velocity", [0, 0]))]
                        for body in self.scene["bodies"]]
        gradient = reference["gradient"]
        self.exact = {"loss": reference["loss"],
                      "gradient": self.comparable(gradient["position"][0] + gradient["velocity"][0])}

    # Derivatives by velocities over the duration: so that they can be compared with those by positions.
    def comparable(self, gradient):
        return [x / self.scene["duration"] if i > 1 else x for i, x in enumerate(gradient)]

    def loss(self, final):
        names = [body["name"] for body in self.scene["bodies"]]
        total = 0
        for term in self.scene["objective"]["terminal"]:
            values = final[names.index(term["body"])]
            values = values[:2] if term["quantity"] == "position" else values[2:]
            if "component" in term:
                total += term["weight"] * values["xy".index(term["component"])]
            else:
                total += term["weight"] * sum((x - y) ** 2 for x, y in zip(values, term["target"]))
        forces = (self.scene.get("control") or {}).get("initial", [])
        effort = sum(x * x for force in forces for x in force)
        return total + self.scene["objective"].get("effort", 0) * effort * self.scene["duration"]

    # What to ask at so many steps: the start, and the first disc displaced by each of the widths in all four numbers.
    def requests(self, steps, widths):
        starts = [self.initial]
        for width in widths:
            for entry in range(4):
                for sign in (1, -1):
                    start = [list(row) for row in self.initial]
                    start[0][entry] += sign * width
                    starts.append(start)
        control = self.scene.get("control") or {}
        rows = [control["initial"]] if control.get("bodies") else []
        return [(steps, self.scene["duration"], start, rows) for start in starts]

    # The loss, and a gradient for each width, of the answers to that.
    def differences(self, finals, widths):
        losses = [self.loss(final) for final in finals]
        slopes = iter((up - down) / 2 for up, down in zip(losses[1::2], losses[2::2]))
        return losses[0], [self.comparable([next(slopes) / width for _ in range(4)]) for width in widths]


# A scene file as a dict.
def scene_in(path):
    import yaml  # python3-yaml, which --check does without
    scene = yaml.safe_load(path.read_text(encoding="utf-8"))
    scene["contact"] = {key: float(value) for key, value in scene["contact"].items()}  # it takes "1.0e4" for text
    return scene


# {steps: [loss, gradient]}: of a few neighbouring step counts those whose errors are the medians.
def by_step(task, command, width):
    counts = [[factor * task.scene["steps"] + more for more in SAMPLES] for factor in REFINEMENTS]
    requests = [request for level in counts for steps in level for request in task.requests(steps, [width])]
    finals = iter(final_states(command, task.scene, requests))
    size = 1 + 2 * 4
    levels = {}
    for level in counts:
        found = [task.differences([next(finals) for _ in range(size)], [width]) for _ in level]
        loss = statistics.median_low(sorted((abs(loss - task.exact["loss"]), loss) for loss, _ in found))[1]
        gradient = statistics.median_low(
            sorted((relative_error(gradient, task.exact["gradient"]), gradient) for _, (gradient,) in found))[1]
        levels[str(level[0])] = [loss, gradient]
    return levels


def measured(row, name, task, command):
    exact, narrow = task.exact, NARROW[row["precision"]]
    found = {"id": row["id"], "task": name}
    try:
        finals = final_states(command, task.scene, task.requests(task.scene["steps"], [narrow, task.wide]))
        study = {"by_step": by_step(task, command, narrow)}
    except NotApplicable as reason:
        return {**found, "verdict": "not applicable", "reason": str(reason)}
    except DriverError as reason:
        return {**found, "verdict": "failed", "reason": str(reason)}
    loss, gradients = task.differences(finals, [narrow, task.wide])
    narrow_error, wide_error = (relative_error(gradient, exact["gradient"]) for gradient in gradients)
    return {**found, "loss": f"{loss:.6g}", "loss_error": f"{abs(loss - exact['loss']) / abs(exact['loss']):.2g}",
            "narrow_error": f"{narrow_error:.2g}", "wide_error": f"{wide_error:.2g}",
            "motion": of_motion(study, exact), "verdict": of_gradient(study, exact, row["precision"] == "float32")}


# What the audit says of an engine, at the steps of the task, and the document that has it.
def audit_of(name, command, program):
    path, _, wide = TASKS[name]
    boxes = [] if wide else ["--solver=none", f"--steps={BOX_STEPS}"]
    program = program if wide else pathlib.Path(program).with_name("saltus_bodies")
    done = subprocess.run([program, f"--scene={path}", f"--simulate=engine={shlex.join(command)}", "--json",
                           "--progress=none", *boxes], capture_output=True, text=True, check=False)
    document = json.loads(done.stdout)
    return document["audits"][0], document


def measured_boxes(row, name, command, program):
    audit, document = audit_of(name, command, program)
    duration = document["guess"]["duration"]
    found = {"id": row["id"], "task": name}
    refused = audit.get("reason", "").startswith("this driver")
    if refused or "gradient" not in audit:
        reason = audit["reason"].partition(" in step ")[0]
        return {**found, "verdict": "not applicable" if refused else "failed", "reason": reason}
    # Of [x y angle and their rates], as of Task.comparable.
    gradient, exact = ([x / duration if i > 2 else x for i, x in enumerate(audit[key]["initial"])]
                       for key in ("gradient", "exact_gradient"))
    return {**found, "loss": f"{audit['loss']:.6g}",
            "loss_error": f"{abs(audit['loss'] - audit['exact_loss']) / audit['exact_loss']:.2g}",
            "narrow_error": f"{relative_error(gradient, exact):.2g}", "verdict": audit["verdict"],
            "reason": audit.get("reason", "") if audit["verdict"] == "unknown" else ""}


def read(path):
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as table:
        return list(csv.DictReader(table))


# In the order of data/engines.csv and of TASKS.
def write(path, rows):
    order = [(row["id"], task) for row in engines() for task in TASKS]
    with open(path, "w", newline="", encoding="utf-8") as table:
        writer = csv.DictWriter(table, COLUMNS, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: order.index((row["id"], row["task"]))))


# Where what saltus_audit says of an engine differs from its rows.
def disagreements(row, expected, name, command, program):
    found, _ = audit_of(name, command, program)
    if "loss" not in found or not expected["loss"]:
        refused = (expected["verdict"] == found.get("termination", "").replace("_", " ")
                   or found.get("reason", "").startswith(expected["reason"] or "-"))
        return [] if refused else [found.get("reason", "it is measured")]
    texts = []
    if (found["verdict"] in GOOD) != (expected["verdict"] in GOOD):
        texts.append(f"verdict: {found['verdict']}, expected {expected['verdict']}")
    if "class" in found:
        if (found["motion"] == "does not converge") != (expected["motion"] == "does not converge"):
            texts.append(f"motion: {found['motion']}, expected {expected['motion']}")
        if not row["class"].startswith(words(found["class"])):
            texts.append(f"class: {found['class']}, expected {row['class']}")
    tolerance = FLOAT32 if row["precision"] == "float32" else 1e-5
    if abs(found["loss"] - float(expected["loss"])) > tolerance * max(1, abs(found["loss"])):
        texts.append(f"loss: {found['loss']:.6g}, expected {expected['loss']}")
    return texts


# The class in the words of data/engines.csv.
def words(contact_class):
    return contact_class.replace("at a step boundary", "at step boundary")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("output", type=pathlib.Path, nargs="?", help="a name that ends in .csv")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--build", type=pathlib.Path, default=HERE.parent / "build" / "engines")
    parser.add_argument("--audit", default=str(ROOT / "build" / "release" / "bin" / "saltus_audit"))
    parser.add_argument("--tasks", default=",".join(TASKS))
    parser.add_argument("id", nargs="*")
    arguments = parser.parse_intermixed_args()
    if arguments.output is not None and arguments.output.suffix != ".csv":
        arguments.id, arguments.output = [str(arguments.output), *arguments.id], None
    if arguments.check == (arguments.output is not None):
        parser.error("expected either OUTPUT.csv or --check")
    rows = [row for row in engines() if not arguments.id or row["id"] in arguments.id]
    names = arguments.tasks.split(",")
    unknown = (set(arguments.id) - {row["id"] for row in rows}) | (set(names) - set(TASKS))
    if unknown:
        parser.error(f"no engine or task {', '.join(sorted(unknown))}")
    known = {(row["id"], row["task"]): row for row in read(COMMITTED if arguments.check else arguments.output)}
    commands = {row["id"]: command_of(row, arguments.build) for row in rows}
    for row in rows:
        if commands[row["id"]] is None:
            print(f"{row['id']}: not installed, or not built ({how_to_get(row)})", flush=True)
    there = [row for row in rows if commands[row["id"]] is not None]
    of_discs = [name for name in names if TASKS[name][2]] if there and not arguments.check else []
    tasks = {name: Task(name, arguments.audit) for name in of_discs}
    failed = 0
    for row in there:
        for name in names:
            command, key = commands[row["id"]], (row["id"], name)
            if arguments.check:
                texts = disagreements(row, known[key], name, command, arguments.audit)
                failed += bool(texts)
                print(f"{row['id']}, {name}: {'; '.join(texts) or 'as in the table'}", flush=True)
            elif key not in known:
                known[key] = (measured(row, name, tasks[name], command) if name in tasks
                              else measured_boxes(row, name, command, arguments.audit))
                write(arguments.output, known.values())
                print(f"{row['id']}, {name}: {known[key]['verdict']}", flush=True)
    return 77 if arguments.check and not there else int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
