#!/usr/bin/env python3
"""Words, links and spelling of the pages, the help texts and lists of the programs, their messages, and the Python module;
and comments of the C++ sources that need the line before them to be understood.

usage: words_test.py [--build=DIR]        Spelling by codespell, where it is installed.

The pages are README.md, CONTRIBUTING.md, CHANGELOG.md and docs/. Messages are the string literals with a blank of C++, of the
scripts of pages, and of the Python module, whose docstrings are among them.
"""

import argparse
import ast
import pathlib
import re
import runpy
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
PROGRAMS = ["saltus_audit", "saltus_bodies", "saltus_solve", "saltus_sweep", "saltus_identify", "saltus_scene",
            "saltus_simulate", "saltus_replay", "saltus_reproduce"]
LITERAL = {suffix: re.compile("|".join(rf"{quote}(?:[^{quote}\\\n]|\\.)*{quote}" for quote in quotes))
           for suffix, quotes in {".cc": '"', ".h": '"', ".js": "\"'`", ".mjs": "\"'`"}.items()}
NOTEBOOK_AS_MARKDOWN = runpy.run_path(str(SOURCE / "docs" / "conf.py"))["notebook_as_markdown"]


def prose(text):
    """Without code, and with as many lines."""
    text = re.sub(r"^(```+).*?^\1$", lambda m: "\n" * m[0].count("\n"), text, flags=re.M | re.S)
    text = re.sub(r"<!--.*?-->|<img[^>]*>", "", text)
    return re.sub(r"`[^`]*`", lambda m: "\n" * m[0].count("\n"), text)


def read(page):
    text = page.read_text(encoding="utf-8")
    return NOTEBOOK_AS_MARKDOWN(text) if page.suffix == ".ipynb" else text


# Texts of JSON documents, which stay as they are until a version that changes outputs, and a default of a public member.
KEPT = ["this model knows no friction", "own term"]


def messages(text, suffix):
    """The string literals of a source in C++ or JavaScript, in their lines; those without a blank are keys, not sentences."""
    text = re.sub(r"^[ \t]*(//|#include).*$", "", text, flags=re.M)
    for kept in KEPT:
        text = text.replace(kept, "")
    return "\n".join(" ".join(literal for literal in LITERAL[suffix].findall(line) if " " in literal) for line in text.split("\n"))


def python_texts(text):
    """The docstrings and messages of a Python module, each in the line in which it begins."""
    lines = [""] * text.count("\n")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            lines[node.lineno - 1] += " " + node.value.replace("\n", " ")
    return "\n".join(lines)


UNFINISHED = re.compile(r"^[ \t]*// (Of|The same|Those|As|Likewise|So far|Such|What|Whether and)\b")


def unfinished_comments(text):
    """The numbers of the lines at which a comment begins with a word that refers to what was said before it."""
    lines = text.split("\n")
    return [k + 1 for k, line in enumerate(lines)
            if UNFINISHED.match(line) and not (k > 0 and lines[k - 1].lstrip().startswith("//"))]


def slug(title):
    return re.sub(r"[^a-z0-9 _-]", "", title.lower().replace("`", "")).strip().replace(" ", "-")


def ruled_out():
    for line in (HERE / "ruled_out_words.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            pattern, instead = line.split("\t")
            yield re.compile(pattern, re.I), instead


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path)
    arguments = parser.parse_args()
    pages = [*(SOURCE / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
             *sorted((SOURCE / "docs").rglob("*.md")), *sorted((SOURCE / "docs").rglob("*.ipynb"))]
    texts = {str(page.relative_to(SOURCE)): read(page) for page in pages}
    found, words = [], list(ruled_out())
    spoken = {name: prose(text) for name, text in texts.items()}
    if arguments.build:
        for program in PROGRAMS:
            done = subprocess.run([arguments.build.resolve() / "bin" / program, "-h"], capture_output=True, text=True, check=True)
            spoken[f"{program} -h"] = done.stdout
        for flag in ("--contact=list", "--solver=list", "--surrogate=list"):
            done = subprocess.run([arguments.build.resolve() / "bin" / "saltus_solve", flag], capture_output=True, text=True, check=True)
            spoken[f"saltus_solve {flag}"] = done.stdout
    sources = [file for folder in ("src", "include", "engines", "problems", "python")
               for file in (SOURCE / folder).rglob("*") if file.suffix in LITERAL]
    spoken |= {str(file.relative_to(SOURCE)): messages(file.read_text(encoding="utf-8"), file.suffix) for file in sorted(sources)}
    spoken |= {str(file.relative_to(SOURCE)): python_texts(file.read_text(encoding="utf-8"))
               for file in sorted((SOURCE / "python" / "saltus").glob("*.py"))}
    for name, text in spoken.items():
        for k, line in enumerate(text.split("\n")):
            for pattern, instead in words:
                for match in pattern.finditer(line):
                    found.append(f"{name}:{k + 1}: \"{match[0]}\" is ruled out; write: {instead}")
    commented = [file for folder in ("include", "src", "tests", "bench", "python") for file in (SOURCE / folder).rglob("*")
                 if file.suffix in (".h", ".cc")]
    for file in sorted(commented):
        found += [f"{file.relative_to(SOURCE)}:{line}: the comment cannot be read alone; begin with a verb or with the thing"
                  for line in unfinished_comments(file.read_text(encoding="utf-8"))]
    anchors = {page: {slug(m[1]) for m in re.finditer(r"^#+ (.*)$", prose(texts[str(page.relative_to(SOURCE))]), re.M)}
               for page in pages}
    for page in pages:
        name, text = str(page.relative_to(SOURCE)), texts[str(page.relative_to(SOURCE))]
        for match in re.finditer(r"\]\(([^)\s]+)\)", re.sub(r"^(```+).*?^\1$", "", text, flags=re.M | re.S)):
            target, _, anchor = match[1].partition("#")
            if target.startswith("http") or target == "cpp/index.html" or target.startswith("gallery/"):
                continue
            file = (page.parent / target).resolve() if target else page
            if not file.exists():
                found.append(f"{name}: the link {match[1]} leads nowhere")
            elif anchor and anchor not in anchors.get(file, ()):
                found.append(f"{name}: no heading {match[1]}")
    if shutil.which("codespell"):
        with tempfile.TemporaryDirectory() as folder:
            for name, text in spoken.items():
                path = pathlib.Path(folder) / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
            done = subprocess.run(["codespell", "--ignore-words-list", "ba,lets,suh", folder], capture_output=True, text=True,
                                  check=False)
            found += [line.replace(f"{folder}/", "") for line in done.stdout.splitlines()]
    else:
        print("codespell is not installed: the spelling was not checked")
    print("\n".join(found))
    print(f"{len(spoken)} texts, {len(found)} faults")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
