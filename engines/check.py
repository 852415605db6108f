#!/usr/bin/python3
# usage: engines/check.py [--build=DIR] [--impact] [id...]
# Compares the engines that are installed with data/engines.csv on task 3: every digit of a float64 engine, 1e-3 of a
# float32 one; and sees that nothing passes through half-planes and fixed discs. Exit code 1 if one differs, 77 if none
# of those named is there.
import argparse
import csv
import importlib.util
import pathlib
import shutil
import sys

from client import DriverError, NotApplicable
from measure import ENTRIES, differences, impact, oblique_impact, rebound_from_fixed

HERE = pathlib.Path(__file__).resolve().parent
PYTHON_MODULES = {"python3-dartpy": "dartpy", "python3-siconos": "siconos"}
SMALL, WIDE = 1e-6, 1e-2
FLOAT32 = 1e-3  # relative to the size of a number, or absolute below 1


# Rows of the table.
def engines():
    with open(HERE.parent / "data" / "engines.csv", newline="", encoding="utf-8") as table:
        return list(csv.DictReader(table))


# The command of a row, None if it is not built or its package is missing.
def command_of(row, build):
    words = row["command"].split()
    package = row["package"].split()[1]
    if words[0] == "node":
        installed = shutil.which("node") and (HERE / "node_modules" / package).is_dir()
        return ["node", str(HERE / words[1]), *words[2:]] if installed else None
    if words[0] == "python3":
        installed = importlib.util.find_spec(PYTHON_MODULES[package])
        return [sys.executable, str(HERE / words[1]), *words[2:]] if installed else None
    program = build / words[0]
    return [str(program), *words[1:]] if program.exists() else None


# How a row's engine is to be had.
def how_to_get(row):
    kind, *packages = row["package"].split()
    return f"apt-get install {packages[0]}" if kind == "apt" else f"npm install --prefix engines {packages[0]}"


# Half a unit of the last digit shown, and what rounding adds to it.
def last_digit(text):
    return 0.51 * 10.0**-len(text.partition(".")[2])


# Texts that say where the engine differs from its row.
def disagreements(row, command):
    float32 = row["precision"] == "float32"
    found = []

    def compare(column, value, noise=0):
        text = row[column]
        tolerance = FLOAT32 * max(1, abs(float(text))) if float32 else last_digit(text) + noise
        if not abs(value - float(text)) <= tolerance:
            found.append(f"{column}: {value:.6f}, expected {text} within {tolerance:.2g}")

    loss, gradient = differences(command, [SMALL, WIDE])
    compare("loss", loss)
    for entry in ENTRIES:
        if not float32:  # there 1e-6 is a few units in the last place: noise
            # An integrator that chooses its steps answers a displacement of 1e-6 with an error of its own.
            compare(f"small_{entry}", gradient[SMALL][entry], float(row["noise"] or 0))
        compare(f"wide_{entry}", gradient[WIDE][entry])
    oblique_impact(command, 1, 0)
    rebound_from_fixed(command, 1)
    return found


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path, default=HERE.parent / "build" / "engines")
    parser.add_argument("--impact", action="store_true", help="print e, keep and feed too")
    parser.add_argument("id", nargs="*")
    arguments = parser.parse_args()
    rows = [row for row in engines() if not arguments.id or row["id"] in arguments.id]
    unknown = set(arguments.id) - {row["id"] for row in rows}
    if unknown:
        parser.error(f"no engine {', '.join(sorted(unknown))}")
    ran = failed = 0
    for row in rows:
        command = command_of(row, arguments.build)
        if command is None:
            print(f"{row['id']}: not installed, or not built ({how_to_get(row)}; cmake -DSALTUS_BUILD_ENGINES=ON)")
            continue
        try:
            found = disagreements(row, command)
            if arguments.impact:
                print(*(impact(command, steps, row["precision"] == "float32") for steps in (240, 2400)))
        except (DriverError, NotApplicable) as error:
            found = [f"{type(error).__name__}: {error}"]
        ran += 1
        failed += bool(found)
        print(f"{row['id']}: {'; '.join(found) or 'as in the table'}", flush=True)
    return 77 if ran == 0 else int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
