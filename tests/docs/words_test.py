#!/usr/bin/env python3
"""Words, links and spelling of README.md, CONTRIBUTING.md, docs/ and the help texts of the programs.

usage: words_test.py [--build=DIR]        Spelling by codespell, where it is installed.
"""

import argparse
import pathlib
import re
import shutil
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
PROGRAMS = ["saltus_audit", "saltus_solve", "saltus_sweep", "saltus_identify", "saltus_scene", "saltus_simulate",
            "saltus_replay", "saltus_reproduce"]


def prose(text):
    """Without code, and with as many lines."""
    text = re.sub(r"^(```+).*?^\1$", lambda m: "\n" * m[0].count("\n"), text, flags=re.M | re.S)
    text = re.sub(r"<!--.*?-->", "", text)
    return re.sub(r"`[^`]*`", lambda m: "\n" * m[0].count("\n"), text)


def slug(title):
    return re.sub(r"[^a-z0-9 _-]", "", title.lower().replace("`", "")).strip().replace(" ", "-")


def ruled_out():
    for line in (HERE / "ruled_out_words.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            pattern, instead, *where = line.split("\t")
            yield re.compile(pattern, re.I), instead, where == ["pages"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path)
    arguments = parser.parse_args()
    pages = [SOURCE / "README.md", SOURCE / "CONTRIBUTING.md", *sorted((SOURCE / "docs").rglob("*.md"))]
    texts = {str(page.relative_to(SOURCE)): page.read_text(encoding="utf-8") for page in pages}
    found, words = [], list(ruled_out())
    spoken = {name: prose(text) for name, text in texts.items()}
    if arguments.build:
        for program in PROGRAMS:
            done = subprocess.run([arguments.build.resolve() / "bin" / program, "-h"], capture_output=True, text=True, check=True)
            spoken[f"{program} -h"] = done.stdout
    for name, text in spoken.items():
        for k, line in enumerate(text.split("\n")):
            for pattern, instead, pages_only in words:
                if pages_only and name not in texts:
                    continue
                for match in pattern.finditer(line):
                    found.append(f"{name}:{k + 1}: \"{match[0]}\" is ruled out; write: {instead}")
    anchors = {page: {slug(m[1]) for m in re.finditer(r"^#+ (.*)$", prose(page.read_text(encoding="utf-8")), re.M)}
               for page in pages}
    for page in pages:
        name, text = str(page.relative_to(SOURCE)), texts[str(page.relative_to(SOURCE))]
        for match in re.finditer(r"\]\(([^)\s]+)\)", re.sub(r"^(```+).*?^\1$", "", text, flags=re.M | re.S)):
            target, _, anchor = match[1].partition("#")
            if target.startswith("http") or target == "cpp/index.html":
                continue
            file = (page.parent / target).resolve() if target else page
            if not file.exists():
                found.append(f"{name}: the link {match[1]} leads nowhere")
            elif anchor and anchor not in anchors.get(file, ()):
                found.append(f"{name}: no heading {match[1]}")
    if shutil.which("codespell"):
        done = subprocess.run(["codespell", "--ignore-words-list", "ba,lets,suh", *map(str, pages)], capture_output=True, text=True,
                              check=False)
        found += [line.replace(f"{SOURCE}/", "") for line in done.stdout.splitlines()]
    else:
        print("codespell is not installed: the spelling was not checked")
    print("\n".join(found))
    print(f"{len(spoken)} texts, {len(found)} faults")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
