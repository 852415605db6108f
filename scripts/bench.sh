#!/usr/bin/env bash
# usage: scripts/bench.sh [output folder] [flags of google-benchmark...]
# Runs all benchmarks and writes bench.md, bench.html, python.txt, and the raw results. The folder is results/bench/
# unless given. Times are of the thread, but a busy machine still blurs them: compare numbers of one run only.
set -euo pipefail

output=
if (($# > 0)) && [[ $1 != -* ]]; then
  output=$(realpath -m -- "$1")
  shift
fi
cd "$(dirname "${BASH_SOURCE[0]}")/.."
output=${output:-$PWD/results/bench}
mkdir -p "$output"

cmake --preset release -DSALTUS_BUILD_BENCHMARKS=ON
cmake --build --preset release -j "$(nproc)" \
  --target simulation_benchmark solver_benchmark time_to_solution_benchmark lasting_contact_benchmark bench_report gradient_cost
results=()
for benchmark in simulation solver time_to_solution lasting_contact; do
  "build/release/bench/${benchmark}_benchmark" --benchmark_out="$output/$benchmark.json" \
    --benchmark_out_format=json "$@"
  results+=("$output/$benchmark.json")
done
build/release/bench/bench_report "$output" "${results[@]}"
# What calls from Python cost beside C++, where there is the module.
if cmake --build --preset release -j "$(nproc)" --target saltus_python 2>/dev/null; then
  PYTHONPATH=build/release/python python/bench/cost.py build/release/bench/gradient_cost | tee "$output/python.txt"
fi
echo "Written to $output"
