#!/usr/bin/env bash
# usage: scripts/reproduce.sh [output folder] [flags of saltus_reproduce...]
# Builds the programs and the Python module, and writes every table and figure, next to the published values. The folder is
# report/ unless given.
set -euo pipefail

output=
if (($# > 0)) && [[ $1 != -* ]]; then
  output=$(realpath -m -- "$1")
  shift
fi
cd "$(dirname "${BASH_SOURCE[0]}")/.."
output=${output:-$PWD/report}

scripts/install_packages.sh
cmake --preset release
cmake --build --preset release -j "$(nproc)" --target saltus_programs saltus_python

status=0
build/release/bin/saltus_reproduce --output_dir="$output" "$@" || status=$?
if [[ -f $output/report.html ]]; then echo "The report: $output/report.html"; fi
echo "The programs: $PWD/build/release/bin"
# The interpreter that the module is built for, which may be another one than python3.
python=$(sed -nE 's/^Python_EXECUTABLE:[A-Z]+=//p;s/^_Python_EXECUTABLE:INTERNAL=//p' build/release/CMakeCache.txt | head -1)
echo "The Python module: PYTHONPATH=$PWD/build/release/python $python -c 'import saltus; help(saltus)'"
exit "$status"
