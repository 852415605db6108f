#!/usr/bin/env bash
# usage: scripts/build_cost.sh [--tests] [output file]
# What a build costs: compiles the programs, and with --tests the tests too, in a temporary folder without any cache, and
# prints the CPU seconds of each part, the 20 slowest objects, and the total divided by the CPU seconds of
# scripts/build_cost_reference.cc, compiled in the same run: that quotient can be compared between machines. With an
# output file, the CPU seconds of every command are written there too: "seconds<tab>object or program" a line.
set -euo pipefail

targets=(saltus_programs)
output=
for argument in "$@"; do
  case "$argument" in
    --tests) targets=(all) ;;
    -*)
      echo "usage: scripts/build_cost.sh [--tests] [output file]" >&2
      exit 2
      ;;
    *) output=$(realpath -m -- "$argument") ;;
  esac
done
cd "$(dirname "${BASH_SOURCE[0]}")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export CCACHE_DISABLE=1
unset CMAKE_CXX_COMPILER_LAUNCHER CMAKE_C_COMPILER_LAUNCHER

# Runs a command of the build and notes its CPU seconds, beside what it writes.
cat >"$work/timed" <<EOF
#!/usr/bin/env bash
output= previous=
for argument in "\$@"; do
  if [[ \$previous == -o ]]; then output=\$argument; fi
  previous=\$argument
done
TIMEFORMAT='%U %S'
{ time "\$@" 2>&3; } 3>&2 2>"$work/time.\$\$"
status=\$?
read -r user system < <(tail -n 1 "$work/time.\$\$")
rm "$work/time.\$\$"
printf '%s %s\t%s\n' "\$user" "\$system" "\$output" >>"$work/times"
exit "\$status"
EOF
chmod +x "$work/timed"

# reference: CPU seconds of the reference file.
reference() {
  local TIMEFORMAT='%U %S'
  { time g++ -std=c++20 -O3 -DNDEBUG -isystem /usr/include/eigen3 -c scripts/build_cost_reference.cc \
    -o "$work/reference.o"; } 2>&1 | awk '{ print $1 + $2 }'
}

cmake --preset release -B "$work/build" -DCMAKE_CXX_COMPILER_LAUNCHER="$work/timed" \
  -DCMAKE_CXX_LINKER_LAUNCHER="$work/timed" >"$work/configure" || { cat "$work/configure" >&2; exit 1; }
before=$(reference)
start=$SECONDS
cmake --build "$work/build" -j "$(nproc)" --target "${targets[@]}" >"$work/log" 2>&1 || { tail -n 50 "$work/log" >&2; exit 1; }
clock=$((SECONDS - start))
after=$(reference)
awk -F'[ \t]' '{ printf "%.2f\t%s\n", $1 + $2, $3 }' "$work/times" | sort -rn >"$work/sorted"
if [[ -n $output ]]; then cp "$work/sorted" "$output"; fi

awk -F'\t' -v before="$before" -v after="$after" -v clock="$clock" -v cores="$(nproc)" '
  function part(object, piece) {
    if (object ~ /\.gch$/) return "precompiled headers";
    if (object !~ /\.o$/) return "links";
    if (object ~ /(_entry|\/registry)_[0-9]+\.cc\.o$/) return object ~ /^src\// ? "contact models" : "tests";
    if (object ~ /CMakeFiles\/saltus\.dir\//) {
      piece = object;
      sub(/.*CMakeFiles\/saltus\.dir\//, "", piece);
      sub(/(_[0-9]+\.cc\.o$|\/).*/, "", piece);
      return "core: " piece;
    }
    if (object ~ /^(tests|python|engines)\//) { sub(/\/.*/, "", object); return object; }
    if (object ~ /^src\//) { split(object, pieces, "/"); return "room: " pieces[2]; }
    return "problems";
  }
  { seconds[part($2)] += $1; objects[part($2)] += 1; total += $1; }
  END {
    printf "%-24s %10s %8s\n", "part", "CPU s", "files";
    for (name in seconds) printf "%-24s %10.1f %8d\n", name, seconds[name], objects[name] | "sort";
    close("sort");
    reference = (before + after) / 2;
    printf "%-24s %10.1f %8d\n\n", "total", total, NR;
    printf "by the clock: %d s on %d cores\n", clock, cores;
    printf "reference file: %.2f s before, %.2f s after; total / reference: %.0f\n\n", before, after, total / reference;
    print "the 20 slowest:";
  }' "$work/sorted"
head -n 20 "$work/sorted"
