#!/usr/bin/env bash
# usage: scripts/docs.sh [--check] [output folder]
# Builds the documentation into a site that opens from disk: the pages of docs/, the Python module and, by Doxygen, the
# headers of C++. The folder is build/docs/html unless given. If the module is in build/release, the site has the docstrings
# of its compiled classes too; if the programs are there, the gallery has its replays. --check looks for broken links and wrong HTML in the site, and for misspelt words in pages and
# public headers.
set -euo pipefail
check=
if [[ ${1:-} == --check ]]; then
  check=yes
  shift
fi
output=${1:+$(realpath -m -- "$1")}
cd "$(dirname "${BASH_SOURCE[0]}")/.."
output=${output:-$PWD/build/docs/html}

scripts/install_packages.sh python3-sphinx python3-myst-parser furo doxygen ${check:+linkchecker tidy codespell}
work=$PWD/build/docs
rm -rf "$work"
mkdir -p "$work/doxygen/cpp"
# Comments are // in this project; the filter makes those of Doxygen's kind.
printf '#!/bin/sh\nexec sed -E "s,^([[:space:]]*)//([[:space:]]|$),\\1///\\2," "$1"\n' >"$work/filter.sh"
chmod +x "$work/filter.sh"
doxygen - >"$work/doxygen.log" 2>&1 <<DOXYGEN
PROJECT_NAME = saltus
PROJECT_NUMBER = $(sed -nE 's/^project\(saltus VERSION (\S+).*/\1/p' CMakeLists.txt)
INPUT = include/saltus
EXCLUDE = include/saltus/internal
RECURSIVE = YES
EXTRACT_ALL = YES
INPUT_FILTER = $work/filter.sh
JAVADOC_AUTOBRIEF = YES
MARKDOWN_SUPPORT = NO
OUTPUT_DIRECTORY = $work/doxygen/cpp
GENERATE_LATEX = NO
HTML_OUTPUT = .
SEARCHENGINE = YES
SERVER_BASED_SEARCH = NO
HTML_COLORSTYLE_SAT = 0
QUIET = YES
WARNINGS = NO
DOXYGEN

if [[ -x build/release/bin/saltus_solve ]]; then scripts/gallery.py --reports="$work/doxygen/gallery"; fi
python=
for build in build/release; do
  if compgen -G "$build/python/saltus/_saltus.*.so" >/dev/null; then python=$PWD/$build/python; fi
done
PYTHONPATH=${python:-$PWD/python} SALTUS_PYTHON=$python SALTUS_DOXYGEN=$work/doxygen PYTHONDONTWRITEBYTECODE=1 \
  /usr/bin/python3 -m sphinx -q -W --keep-going -b html -d "$work/doctrees" docs "$output"
if [[ $check ]]; then
  # Suh is an author, Numer. a journal, PositionOf a function.
  codespell --skip='*.ipynb,*.svg' --ignore-words-list=suh,numer,positionof README.md CHANGELOG.md CONTRIBUTING.md docs include
  linkchecker --no-robots --no-warnings "$output/index.html" | tail -2
  # Of the theme's own markup, labels around blocks are reported; MathML is unknown to tidy.
  find "$output" -name '*.html' -not -path "$output/cpp/*" -print0 | xargs -0 -n 1 tidy -q -e --drop-empty-elements no 2>&1 |
    grep -vE '<(/?m[a-z]+|/?label|/?button|/?nav)>|proprietary' && exit 1
fi
echo "The documentation: $output/index.html"
