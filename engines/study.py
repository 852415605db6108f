#!/usr/bin/python3
# usage: engines/study.py OUTPUT.json [--build=DIR] [--threads=N] [id...]
# Measures all engines that are installed on task 3: the scan of the loss, errors by step and by width, an impact seen
# from outside. The file is written after each engine, so an interrupted study keeps what it has; engines that it holds
# already are not measured again.
import argparse
import concurrent.futures
import json
import os
import pathlib
import sys

from check import HERE, command_of, engines, how_to_get
from client import DriverError, NotApplicable
from measure import (ENTRIES, INITIAL, differences, displaced, exact_gradient, exact_loss, impact, losses,
                     oblique_impact, rebound_from_fixed)

WIDTHS = [1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2]
STEPS = [120, 240, 480, 960, 1920]
SCAN = [0.02 * k / 50 for k in range(-50, 51)]  # m, about the start of the striker
# A width for differences: with float32 inside, positions of order 1 have units in the last place of 1e-7.
BEST_WIDTH = {"float64": 1e-6, "float32": 1e-4}


# The value of measure(), or what went wrong as a text.
def tried(measure, *given):
    try:
        return measure(*given)
    except (DriverError, NotApplicable) as error:
        return str(error)


# {steps: [loss, gradient]} and {width: gradient}, gradients in the order of ENTRIES.
def by_step(command, width):
    table = {}
    for steps in STEPS:
        loss, gradient = differences(command, [width], steps)
        table[steps] = [loss, [gradient[width][entry] for entry in ENTRIES]]
    return table


def by_width(command):
    _, gradients = differences(command, WIDTHS)
    return {width: [gradient[entry] for entry in ENTRIES] for width, gradient in gradients.items()}


def study(row, command):
    float32 = row["precision"] == "float32"
    return {
        "scan": losses(command, [displaced("p1x", by) for by in SCAN]),
        "by_step": by_step(command, BEST_WIDTH[row["precision"]]),
        "by_width": by_width(command),
        "impact": {steps: tried(impact, command, steps, float32) for steps in (240, 2400)},
        "oblique": tried(oblique_impact, command, 0.5, 0.2),
        "fixed": tried(rebound_from_fixed, command, 0.5),
    }


def exact():
    gradient = exact_gradient()
    return {"loss": exact_loss(INITIAL), "gradient": [gradient[entry] for entry in ENTRIES],
            "scan": [exact_loss(displaced("p1x", by)) for by in SCAN]}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("output", type=pathlib.Path)
    parser.add_argument("--build", type=pathlib.Path, default=HERE.parent / "build" / "engines")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("id", nargs="*")
    arguments = parser.parse_args()
    known = json.loads(arguments.output.read_text()) if arguments.output.exists() else {"engines": {}}
    known.update(exact=exact(), widths=WIDTHS, steps=STEPS, scan=SCAN)
    rows = [row for row in engines() if not arguments.id or row["id"] in arguments.id]
    commands = {row["id"]: command_of(row, arguments.build) for row in rows}
    wanted = [row for row in rows if commands[row["id"]] and row["id"] not in known["engines"]]
    for row in rows:
        if not commands[row["id"]]:
            print(f"{row['id']}: not there ({how_to_get(row)})", file=sys.stderr)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    with concurrent.futures.ThreadPoolExecutor(arguments.threads) as pool:
        jobs = {pool.submit(tried, study, row, commands[row["id"]]): row for row in wanted}
        try:
            for done, job in enumerate(concurrent.futures.as_completed(jobs), 1):
                result = job.result()
                failed = isinstance(result, str)
                known["engines"][jobs[job]["id"]] = {"failed": result} if failed else result
                print(f"{done}/{len(jobs)} {jobs[job]['engine']}{': ' + result if failed else ''}", file=sys.stderr)
                arguments.output.write_text(json.dumps(known))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            print(f"interrupted; {arguments.output} has what was measured", file=sys.stderr)
            return 1
    arguments.output.write_text(json.dumps(known))
    return 0


if __name__ == "__main__":
    sys.exit(main())
