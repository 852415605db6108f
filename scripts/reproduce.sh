#!/usr/bin/env bash
# usage: scripts/reproduce.sh [output folder] [flags of saltus_reproduce...]
# Every table and figure, next to the published values. The folder is report/ unless given.
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
cmake --build --preset release -j "$(nproc)" --target saltus_programs

status=0
build/release/bin/saltus_reproduce --output_dir="$output" "$@" || status=$?
if [[ -f $output/report.html ]]; then echo "The report: $output/report.html"; fi
exit "$status"
