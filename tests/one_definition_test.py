#!/usr/bin/env python3
"""Checks that no two files define different entities of one name with external linkage (the one definition rule).

usage: one_definition_test.py [file...]        All C++ files of the source tree unless files are named.

Where two files of a program define a class, an enumeration, an inline function or an inline variable of one qualified
name, the linker keeps one of the definitions without a message, and the behaviour is undefined. Universal Ctags lists
the definitions. Specializations of a template, overloads, members of anonymous namespaces and static functions are
different entities. Exit code 77: ctags is not installed.
"""

import collections
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parents[1]
TYPES = {"class", "struct", "union", "enum"}
# Programs of their own, which replace functions of the library on purpose.
SEPARATE = ("tests/fuzz/", "tests/consumer/")


def definitions(files):
    """Key and place of every definition that other files could repeat."""
    command = ["ctags", "--languages=C++", "--langmap=C++:+.h", "--kinds-C++=cgsufv", "--fields=+SsnkZ",
               "--fields-C++=+{specialization}{template}{properties}", "--output-format=json", "-f", "-", "-L", "-"]
    done = subprocess.run(command, input="\n".join(map(str, files)), capture_output=True, text=True, check=True)
    for line in done.stdout.splitlines():
        tag = json.loads(line)
        scope, name, path = tag.get("scope", ""), tag["name"], tag["path"]
        local = tag.get("scopeKind") == "function" or "__anon" in scope + name
        static = "static" in tag.get("properties", "") and not path.endswith(".h")
        if tag["_type"] != "tag" or local or static or name == "main":
            continue
        key = (f"{scope}::{name}" if scope else name) + tag.get("specialization", "")
        if tag["kind"] not in TYPES:
            key += tag.get("template", "") + tag.get("signature", "")
        yield key, f"{path}:{tag['line']}"


def clashes(files):
    places = collections.defaultdict(dict)  # by file
    for key, place in definitions(files):
        places[key].setdefault(place.rsplit(":", 1)[0], place)
    return [f"{key} is defined in {' and in '.join(of_file.values())}" for key, of_file in sorted(places.items())
            if len(of_file) > 1]


def check_that_a_clash_is_found():
    texts = {"one.h": "namespace s { struct Segment { int a; }; template <typename T> struct Of {}; inline int F(int) { return 1; }\n"
                      "inline constexpr int kMost = 1; namespace { struct Own {}; } enum class Kind { kA }; }",
             "two.cc": "namespace s { struct Segment { double a; }; template <> struct Of<int> {}; inline int F(int) { return 2; }\n"
                       "inline constexpr int kMost = 2; namespace { struct Own { int b; }; } static int G() { return 1; }\n"
                       "inline int F(double) { return 3; } enum class Kind { kB }; }",
             "three.cc": "namespace s { static int G() { return 2; } namespace t { struct Segment {}; } }"}
    with tempfile.TemporaryDirectory() as folder:
        files = [pathlib.Path(folder) / name for name in texts]
        for file in files:
            file.write_text(texts[file.name], encoding="utf-8")
        found = [line.split(" ")[0] for line in clashes(files)]
    expected = ["s::F(int)", "s::Kind", "s::Segment", "s::kMost"]
    assert found == expected, f"of the clashes {expected} the test finds {found}"


def main():
    if shutil.which("ctags") is None:
        print("skipped: Universal Ctags is not installed")
        return 77
    check_that_a_clash_is_found()
    files = sys.argv[1:] or sorted(
        path for room in ("include", "src", "problems", "python", "tests", "bench") for path in (SOURCE / room).rglob("*")
        if path.suffix in (".h", ".cc") and not str(path.relative_to(SOURCE)).startswith(SEPARATE))
    found = clashes(files)
    print("\n".join(found) if found else f"{len(files)} files, no name is defined twice")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
