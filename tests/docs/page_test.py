#!/usr/bin/env python3
"""Runs the commands and the Python code of a page of documentation, and compares the output that the page shows.

usage: page_test.py --build=DIR [--update] PAGE.md...   --update: writes what is printed into the pages

  ```sh, ```python     run, in the order of the page, in a folder that has what the root of the sources has
  ```text, ```json     right after such a block, with no other block between: its standard output. Numbers agree if they
                       differ by at most one unit of the last digit that is shown, a line of "..." stands for any lines,
                       and numbers below a heading "seconds" are not compared.
  <!-- file: NAME -->  before a block: the block is written to that file
  <!-- not run: WHY --> before a block: nothing is done with it, nor with the output after it
  <!-- exit: N -->     before a command: its exit code, 0 otherwise

Exit code 77 (skipped) if the page has Python code and the module is not built.
"""

import argparse
import contextlib
import io
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import traceback

SOURCE = pathlib.Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"(?P<notes>(?:<!--[^>]*-->\s*\n)*)^(?P<fence>```+)(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=fence)$", re.M | re.S)
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def last_digit(number):
    """What one unit of the last digit of a number is worth."""
    mantissa, _, exponent = number.lower().partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def same_token(shown, printed):
    if shown == printed:
        return True
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed)):
        # Values that are zero but for rounding.
        if "e-1" in a.lower() and abs(float(a)) < 1e-14 and abs(float(b)) < 1e-14:
            continue
        if abs(float(a) - float(b)) > 1.001 * last_digit(a):
            return False
    return True


def same_line(shown, printed, free):
    """Whether two lines agree; `free` has the columns, of the printed one, whose numbers differ from run to run."""
    a, b = list(re.finditer(r"\S+", shown)), list(re.finditer(r"\S+", printed))
    if len(a) != len(b):
        return False
    for x, y in zip(a, b):
        if any(y.start() < end and start < y.end() for start, end in free) and NUMBER.fullmatch(y[0]):
            continue
        if set(x[0]) == set(y[0]) == {"-"}:
            continue
        if not same_token(x[0], y[0]):
            return False
    return True


def free_columns(lines):
    """For each printed line, the columns below a heading "seconds"."""
    free, current = [], []
    heading = []
    for line in lines:
        if not line.strip():
            current, heading = [], []
        elif re.fullmatch(r"[- ]*-[- ]*", line):
            rules = [m.span() for m in re.finditer(r"-+", line)]
            current = [r for r in rules for head in heading for m in re.finditer(r"\bseconds\b", head)
                       if r[0] < m.end() and m.start() < r[1]]
        heading.append(line)
        free.append(current)
    return free


def difference(shown, printed):
    """None if the printed text is what is shown, else the first line that is not."""
    want = [line.rstrip() for line in shown.rstrip("\n").split("\n")]
    have = [line.rstrip() for line in printed.rstrip("\n").split("\n")]
    free = free_columns(have)
    at, skipping = 0, False
    for line in want:
        if line.strip() == "...":
            skipping = True
            continue
        while True:
            if at >= len(have):
                return f"shown, but not printed: {line!r}"
            found = same_line(line, have[at], free[at])
            at += 1
            if found:
                break
            if not skipping:
                return f"shown   {line!r}\n  printed {have[at - 1]!r}"
        skipping = False
    if at < len(have) and not skipping:
        return f"printed, but not shown: {have[at]!r}"
    return None


def blocks_of(text):
    found = list(BLOCK.finditer(text))
    for k, match in enumerate(found):
        notes = dict(re.findall(r"<!-- (file|not run|exit): (.*?) -->", match["notes"]))
        yield match, notes, found[k + 1] if k + 1 < len(found) else None


def run_page(page, build, folder, update):
    text, shown = page.read_text(encoding="utf-8"), []
    try:
        name = page.resolve().relative_to(SOURCE)
    except ValueError:
        name = page
    environment = dict(os.environ, COLUMNS="100", MPLBACKEND="agg", PYTHONDONTWRITEBYTECODE="1")
    environment["PATH"] = f"{build / 'bin'}:{environment['PATH']}"
    environment["PYTHONPATH"] = f"{build / 'python'}:{environment.get('PYTHONPATH', '')}"
    environment.pop("CLICOLOR_FORCE", None)
    space, failures, ran = {"__name__": "__page__"}, [], 0
    for match, notes, following in blocks_of(text):
        line = text.count("\n", 0, match.start("fence")) + 1
        if "not run" in notes:
            continue
        if "file" in notes:
            (folder / notes["file"]).parent.mkdir(parents=True, exist_ok=True)
            (folder / notes["file"]).write_text(match["text"], encoding="utf-8")
            continue
        language = match["language"].strip()
        if language not in ("sh", "python"):
            continue
        ran += 1
        # Never in a test: what builds, installs or runs other tests would write into the build under test.
        if language == "sh" and re.search(r"\b(?:scripts/|cmake|ctest|ninja|pip|apt-get|npm)", match["text"]):
            failures.append(f"{name}:{line}: builds or installs; mark the block: <!-- not run: WHY -->")
            continue
        if language == "sh":
            done = subprocess.run(["bash", "-euo", "pipefail", "-c", match["text"]], cwd=folder, env=environment, text=True,
                                  stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=600)
            printed, code, errors = done.stdout, done.returncode, done.stderr
        else:
            output, code, errors = io.StringIO(), 0, ""
            with contextlib.redirect_stdout(output):
                try:
                    exec(compile(match["text"], f"{name}:{line}", "exec"), space)  # pylint: disable=exec-used
                except Exception:  # pylint: disable=broad-except
                    code, errors = 1, traceback.format_exc()
            printed = output.getvalue()
        if code != int(notes.get("exit", 0)):
            failures.append(f"{name}:{line}: exit code {code}\n{errors}{printed}")
            continue
        if following and following["language"].strip() in ("text", "json") and not following["notes"]:
            between = text[match.end() : following.start()]
            if "\n#" not in between:
                wrong = difference(following["text"], printed)
                if wrong and update:
                    shown.append((following.start("text"), following.end("text"), printed.rstrip("\n") + "\n"))
                    continue
                if wrong:
                    failures.append(f"{name}:{line}: {match['text'].strip()}\n  {wrong}\n--- printed\n{printed}---")
    for begin, end, printed in reversed(shown):
        text = text[:begin] + printed + text[end:]
    if shown:
        page.write_text(text, encoding="utf-8")
    print(f"{name}: {ran} blocks ran, {len(failures)} failed")
    return failures


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--update", action="store_true")
    parser.add_argument("pages", type=pathlib.Path, nargs="+")
    arguments = parser.parse_args()
    build = arguments.build.resolve()
    sys.path.insert(0, str(build / "python"))
    sys.dont_write_bytecode = True
    os.environ["MPLBACKEND"] = "agg"
    failures = []
    for page in [page.resolve() for page in arguments.pages]:
        if "```python" in page.read_text(encoding="utf-8") and not list((build / "python" / "saltus").glob("_saltus.*")):
            print(f"{page.name}: the Python module is not built")
            return 77
        folder = pathlib.Path(tempfile.mkdtemp(prefix="saltus_page_"))
        try:
            for entry in SOURCE.iterdir():
                if entry.name in ("problems", "data"):  # copies: commands may write there
                    shutil.copytree(entry, folder / entry.name)
                elif entry.name not in ("build", ".git", "report"):
                    (folder / entry.name).symlink_to(entry)
            (folder / "build").mkdir()
            (folder / "build" / "release").symlink_to(build)
            os.chdir(folder)
            failures += run_page(page, build, folder, arguments.update)
        finally:
            os.chdir("/")
            shutil.rmtree(folder)
    for failure in failures:
        print(failure)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
