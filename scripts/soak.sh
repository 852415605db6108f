#!/usr/bin/env bash
# usage: scripts/soak.sh [rounds] [preset] [flags of ctest...]
# Runs the suite as often as said (20) on a busy machine, in turns on one core and on two, and says how often it was
# green. The preset (release) must be built. Fails if any round failed; their tests are named.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

rounds=20
if (($# > 0)) && [[ $1 =~ ^[0-9]+$ ]]; then
  rounds=$1
  shift
fi
preset=release
if (($# > 0)) && [[ $1 != -* ]]; then
  preset=$1
  shift
fi

scripts/install_packages.sh stress
stress --quiet --cpu 4 --io 1 &
load=$!
log=$(mktemp)
trap 'kill "$load"; rm -f "$log"' EXIT

green=0
for ((round = 1; round <= rounds; ++round)); do
  cores=0
  if ((round % 2 == 0)); then cores=0,1; fi
  if taskset -c "$cores" ctest --preset "$preset" --no-tests=error -j 2 "$@" >"$log" 2>&1; then
    green=$((green + 1))
    echo "round $round (cores $cores): green"
  else
    echo "round $round (cores $cores):"
    grep -E '^\s+[0-9]+ - |tests passed|^No tests' "$log" || tail -5 "$log"
  fi
done
echo "$green of $rounds rounds green"
((green == rounds))
