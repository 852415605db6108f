#!/usr/bin/env bash
# usage: scripts/fuzz.sh [executions of each target] [targets...]
# Feeds the targets of tests/fuzz/targets.h (all unless named) with that many random inputs each, 100000 unless given,
# under AddressSanitizer and UndefinedBehaviorSanitizer. What crashes, leaks, takes 25 s or 2 GiB ends the target and is
# kept in build/fuzz/findings/<target>/: mend it and move the input to tests/fuzz/corpus/<target>/. So are inputs that
# reach new code, in build/fuzz/found/<target>/, from which the next run goes on.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

executions=100000
if (($# > 0)) && [[ $1 =~ ^[0-9]+$ ]]; then
  executions=$1
  shift
fi
targets=("$@")
if ((${#targets[@]} == 0)); then targets=(scene sweep points given sequence npy npz extremes); fi

scripts/install_packages.sh clang-16 libclang-rt-16-dev
cmake --preset fuzz

corpus=tests/fuzz/corpus
failed=0
for target in "${targets[@]}"; do
  if [[ ! -d $corpus/$target ]]; then
    echo "fuzz: '$target' is no target; expected some of $(ls "$corpus" | xargs)" >&2
    exit 2
  fi
  program=saltus_fuzzer_of_targets
  if [[ $target == extremes ]]; then program=saltus_fuzzer_of_runs; fi
  cmake --build --preset fuzz --target "$program"
  options=()
  if [[ -f tests/fuzz/$target.dict ]]; then options+=("-dict=tests/fuzz/$target.dict"); fi
  found=build/fuzz/found/$target
  findings=build/fuzz/findings/$target
  mkdir -p "$found" "$findings"
  status=0
  SALTUS_FUZZ_TARGET=$target GLOG_minloglevel=2 "build/fuzz/tests/fuzz/$program" "$found" "$corpus/$target" \
    -runs="$executions" -max_len=4096 -timeout=25 -rss_limit_mb=2048 "${options[@]}" \
    -artifact_prefix="$findings/" -verbosity=0 -print_final_stats=1 >"build/fuzz/$target.log" 2>&1 || status=$?
  if ((status == 0)); then
    echo "$target: $(sed -n 's/^stat::number_of_executed_units: *//p' "build/fuzz/$target.log") executions, nothing found"
  else
    echo "$target: stopped; see build/fuzz/$target.log and $findings" >&2
    failed=1
  fi
done
exit "$failed"
