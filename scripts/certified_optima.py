#!/usr/bin/env python3
"""Writes the table of certified optima of docs/explanation/global-optima.md.

usage: PYTHONPATH=build/release/python scripts/certified_optima.py [--seconds=60] [--only=NAME...] [--search]

data/certified_optima.csv has one line for each problem: its name (of problems/, or the number of a generated control problem),
the loss of the best control known and the gap that is wanted, then the lower bound, the number of boxes and the CPU time of the
last run. Each bound that is computed again replaces the last one. With --search the loss is that of the solver `global`.
"""

import argparse
import csv
import math
import pathlib
import re
import subprocess
import tempfile
import time

import saltus

ROOT = pathlib.Path(__file__).resolve().parents[1]
LIST = ROOT / "data" / "certified_optima.csv"
PAGE = ROOT / "docs" / "explanation" / "global-optima.md"
PLACE = re.compile(r"(<!-- certified optima -->\n).*?(<!-- end -->)", re.S)
COLUMNS = ["problem", "loss", "wanted_gap", "lower_bound", "boxes", "seconds"]


def scene_of(name: str):
    if not name.isdigit():
        return saltus.load_scene(ROOT / "problems" / f"{name}.yaml")
    program = ROOT / "build" / "release" / "bin" / "saltus_scene"
    text = subprocess.run([program, "--kind=control", f"--seed={name}"], check=True, capture_output=True).stdout
    with tempfile.NamedTemporaryFile(suffix=".yaml") as file:
        file.write(text)
        file.flush()
        return saltus.load_scene(file.name)


def bound(row: dict, seconds: float, search: bool) -> None:
    scene = scene_of(row["problem"])
    if search:
        loss = saltus.solve(scene, "event", "global")["final_loss"]
        row["loss"] = f"{math.ceil(1e12 * loss) / 1e12:.12f}"  # rounded up: there is a control of that loss
    begin = time.process_time()
    proof = saltus.bound_globally(scene, float(row["loss"]), gap=float(row["wanted_gap"]), seconds=seconds, boxes=0)
    row["seconds"] = f"{time.process_time() - begin:.1f}"
    row["lower_bound"] = f"{proof['lower_bound']:.12f}"
    row["boxes"] = str(proof["boxes"])


def table(rows: list[dict]) -> str:
    lines = ["| problem | loss | lower bound | gap | boxes | CPU time, s |", "|---|---|---|---|---|---|"]
    for row in rows:
        name = row["problem"]
        if name.isdigit():
            kind = scene_of(name).name.rsplit("_", 1)[0].replace("_", " ")
            name = f"{kind}, seed {name}"
        else:
            name = f"`{name}`"
        gap = float(row["loss"]) - float(row["lower_bound"])
        mark = "" if gap <= 1.0001 * float(row["wanted_gap"]) else " (limit)"
        lines.append(f"| {name} | {row['loss']} | {row['lower_bound']} | {gap:.1e}{mark} | {row['boxes']} | {row['seconds']} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=60, help="limit of the CPU time for each bound")
    parser.add_argument("--only", nargs="*", help="bound only these problems again")
    parser.add_argument("--search", action="store_true", help="search for the best control again")
    options = parser.parse_args()
    with LIST.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if options.only is not None and row["problem"] not in options.only:
            continue
        bound(row, options.seconds, options.search)
        print(row["problem"], row["lower_bound"], row["boxes"], row["seconds"], flush=True)
    with LIST.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    text = PAGE.read_text()
    PAGE.write_text(PLACE.sub(lambda match: match[1] + table(rows) + match[2], text))


if __name__ == "__main__":
    main()
