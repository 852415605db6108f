#!/usr/bin/env bash
# usage: scripts/engines.sh [output folder] [--no-install] [id of data/engines.csv...]
# Audits simulators that others wrote: installs what is missing (Debian's packages and npm's, 0.5 GB in all), builds
# the drivers, compares each with data/engines.csv, measures it on all tasks (engine_tasks.csv; data/engine_tasks.csv is
# such a table) and writes engines.html. The folder is report/ unless given. An engine that cannot be had is a row that
# says how to get it. What is measured is not measured again: interrupted, it goes on where it was.
set -euo pipefail

output= install=1 ids=()
for argument in "$@"; do
  case "$argument" in
    --no-install) install=0 ;;
    -*)
      echo "usage: scripts/engines.sh [output folder] [--no-install] [id of data/engines.csv...]" >&2
      exit 2
      ;;
    */* | .*) output=$(realpath -m -- "$argument") ;;
    *) ids+=("$argument") ;;
  esac
done
cd "$(dirname "${BASH_SOURCE[0]}")/.."
output=${output:-$PWD/report}
mkdir -p "$output"

if ((install)); then
  scripts/install_packages.sh python3 python3-yaml
  # Each by itself: that one is not to be had is no reason to do without the others.
  mapfile -t packages < <(grep -oE ',apt [a-z0-9-]+' data/engines.csv | cut -d' ' -f2 | sort -u)
  for package in "${packages[@]}"; do
    scripts/install_packages.sh "$package" || echo "engines: going on without $package" >&2
  done
  command -v npm >/dev/null || scripts/install_packages.sh nodejs npm || true
  npm install --prefix engines --no-audit --no-fund --no-package-lock --ignore-scripts ||
    echo "engines: going on without npm's" >&2
fi
cmake -S engines -B build/engines -G Ninja -DCMAKE_BUILD_TYPE=Release
cmake --build build/engines -j "$(nproc)" -- -k 0 || echo "engines: going on without those that do not build" >&2

status=0
engines/check.py "${ids[@]}" || status=$?
engines/study.py "$output/engines.json" "${ids[@]}" || status=1
{ cmake --preset release && cmake --build --preset release -j "$(nproc)" --target saltus_audit; } || status=1
engines/tasks.py "$output/engine_tasks.csv" "${ids[@]}" || status=1
engines/report.py "$output/engines.json" "$output/engines.html" --tasks="$output/engine_tasks.csv"
echo "The report: $output/engines.html"
exit "$status"
