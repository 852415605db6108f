#!/usr/bin/env bash
# usage: scripts/seed_faults.sh [--afresh] [id...]
# Do the tests catch faults? Seeds those of tests/faults.tsv (all unless named), one at a time, in a copy of the sources
# under build/faults/, builds the tests that the list expects to see the fault, and says which of them fails. Faults that
# build/faults/results.tsv has already are not seeded again, unless named or --afresh. Fails if fewer than 95 % of all
# are caught, a fault does not apply or compile, or a test fails without any fault.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

list=tests/faults.tsv
work=$PWD/build/faults
tree=$work/tree
build=$tree/build/release
results=$work/results.tsv
log=$work/log
seconds=900  # of a test, after which it counts as one that hangs
afresh=0
if (($# > 0)) && [[ $1 == --afresh ]]; then
  afresh=1
  shift
fi
mkdir -p "$tree" "$log"
if ((afresh)); then rm -f "$results"; fi
touch "$results"

# Each fault must apply: what it replaces stands exactly once in its file.
perl -F'\t' -lane '
  next if /^(#|id\t|$)/;
  open my $in, "<", $F[1] or die "$F[0]: no file $F[1]\n";
  my $text = do { local $/; <$in> };
  my $count = () = $text =~ /\Q$F[2]\E/g;
  if (@F != 5 || $count != 1) { print STDERR "$F[0]: \"$F[2]\" stands $count times in $F[1], expected once"; $bad = 1; }
  END { exit $bad ? 2 : 0; }' "$list"

# program_of <test or test:filter>: the program that has the tests of <test>.cc.
program_of() {
  local program
  program=$(awk -v test="${1%%:*}" '$1 == test { print $2 }' "$build/tests/programs.txt")
  echo "${program:-${1%%:*}}"
}

# filter_of <test or test:filter>: the tests of its file, unless it has a filter.
filter_of() {
  if [[ $1 == *:* ]]; then
    echo "${1#*:}"
  else
    find tests -name "$1.cc" -exec cat {} + |
      sed -nE 's/^(TYPED_)?TEST(_F|_P)?\(([A-Za-z0-9_]+), *([A-Za-z0-9_]+)\).*/\3.\4:*\/\3.\4\/*:\3\/*.\4/p' | paste -sd:
  fi
}

# build_tests <log> <test...>
build_tests() {
  local targets
  mapfile -t targets < <(for test in "${@:2}"; do program_of "$test"; done | sort -u)
  cmake --build "$build" --target "${targets[@]}" >"$log/$1.build" 2>&1
}

# run_test <log> <test or test:filter>
run_test() {
  local name filter
  name=$(program_of "$2")
  filter=$(filter_of "$2")
  (cd "$build/tests" && timeout "$seconds" "./$name" --gtest_brief=1 "--gtest_filter=$filter") \
    >"$log/$1" 2>&1 && ! grep -q '\] 0 tests' "$log/$1"
}

# seed <file> <old> <new>
seed() {
  OLD=$2 NEW=$3 perl -0777 -pe 's/\Q$ENV{OLD}\E/$ENV{NEW}/' "$1" >"$tree/$1"
}

ids=() files=() olds=() news=() tests=()
# By a separator that is not a blank, as `read` takes several of those for one: a replacement may be empty.
while IFS=$'\x1f' read -r id file old new seen; do
  if [[ -z $id || $id == '#'* || $id == id ]]; then continue; fi
  if (($# > 0)) && [[ " $* " != *" $id "* ]]; then continue; fi
  if (($# == 0)) && cut -f1 "$results" | grep -qxF "$id"; then continue; fi
  ids+=("$id") files+=("$file") olds+=("$old") news+=("$new") tests+=("$seen")
done < <(tr '\t' '\037' <"$list")

failed=0
if ((${#ids[@]} > 0)); then
  # The copy loses the files that the sources have lost. It gets those that are newer in the sources, and those in which
  # a run that was killed has left a fault.
  LC_ALL=C comm -z -13 <(git ls-files --cached --others --exclude-standard -z | LC_ALL=C sort -z) \
    <(cd "$tree" && find . -path ./build -prune -o -type f -printf '%P\0' | LC_ALL=C sort -z) |
    (cd "$tree" && xargs -0 -r rm)
  git ls-files --cached --others --exclude-standard -z | xargs -0 cp --parents -p -u -t "$tree"
  perl -F'\t' -lane 'print $F[1] if @F == 5 && $F[0] ne "id"' "$list" | sort -u | while read -r file; do
    cmp -s "$file" "$tree/$file" || cp "$file" "$tree/$file"
  done
  cmake -S "$tree" -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DSALTUS_UNITY=OFF \
    >"$log/configure" 2>&1 || { tail -5 "$log/configure" >&2; exit 1; }
  # Without a fault every test must pass.
  mapfile -t used < <(tr ' ' '\n' <<<"${tests[*]}" | sort -u)
  build_tests none "${used[@]}" || { tail -20 "$log/none.build" >&2; exit 1; }
  for test in "${used[@]}"; do
    if ! run_test none "$test"; then
      echo "without a fault: $test fails; see $log/none" >&2
      exit 1
    fi
  done
fi

for i in "${!ids[@]}"; do
  id=${ids[i]}
  seed "${files[i]}" "${olds[i]}" "${news[i]}"
  verdict=missed by=''
  read -ra seen <<<"${tests[i]}"
  if ! build_tests "$id" "${seen[@]}"; then
    verdict='does not compile' failed=1
  else
    for test in "${seen[@]}"; do
      if ! run_test "$id" "$test"; then
        verdict=caught by=$(sed -nE '/^\[  FAILED  \] ([^ ,]+).*/{s//\1/p;q}' "$log/$id")
        by=$test${by:+ ($by)}
        break
      fi
    done
  fi
  cp "${files[i]}" "$tree/${files[i]}"
  grep -vE "^$id"$'\t' "$results" >"$results.new" || true
  printf '%s\t%s\t%s\t%s\n' "$id" "${files[i]}" "$verdict" "$by" >>"$results.new"
  mv "$results.new" "$results"
  printf '%-28s %-36s %s %s\n' "$id" "${files[i]}" "$verdict" "$by"
done

all=$(wc -l <"$results")
caught=$(cut -f3 "$results" | grep -cx caught || true)
echo "$caught of $all seeded faults are caught"
((failed == 0 && all > 0 && 100 * caught >= 95 * all))
