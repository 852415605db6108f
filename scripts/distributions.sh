#!/usr/bin/env bash
# usage: scripts/distributions.sh [--quick] [suite...]
# Runs both commands of the README in a bare chroot of each Debian suite (bookworm and trixie unless given), as on a fresh
# machine, then makes the Python wheel there and runs it in a second chroot that has NumPy and none of saltus's libraries.
# Prints the time of each step. Needs root, debootstrap, some 12 GB of disk and hours. With --quick the tests are not run.
# The chroots stay in build/distributions for the next call; what is committed is tested, in a clone.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

quick=
if [[ ${1-} == --quick ]]; then
  quick=1
  shift
fi
((EUID == 0)) || { echo "distributions: found user $(id -un), expected root: debootstrap and chroot need it" >&2; exit 1; }
scripts/install_packages.sh debootstrap
place=$PWD/build/distributions
mkdir -p "$place"
mounted=()
trap 'for at in "${mounted[@]}"; do umount -l "$at"; done' EXIT

# bare <folder> <suite>: a chroot of the smallest Debian, which programs can run in.
bare() {
  # A folder debootstrap is left where it was interrupted.
  [[ -f $1/etc/debian_version && ! -d $1/debootstrap ]] || debootstrap --variant=minbase "$2" "$1" >"$place/log" || { cat "$place/log"; exit 1; }
  for at in proc sys dev; do
    if mountpoint -q "$1/$at"; then continue; fi
    mount --bind "/$at" "$1/$at"
    mounted+=("$1/$at")
  done
  cp /etc/resolv.conf "$1/etc/"
}

# timed <what> <command...>: runs it, with its output in a file that is shown if it fails, and prints its time.
timed() {
  local what=$1 begin=$SECONDS
  shift
  "$@" >"$place/log" 2>&1 || { tail -n 100 "$place/log"; echo "$what: failed"; exit 1; }
  echo "$what: $((SECONDS - begin)) s"
}

suites=("$@")
if ((${#suites[@]} == 0)); then suites=(bookworm trixie); fi
for suite in "${suites[@]}"; do
  bare "$place/$suite" "$suite"
  rm -rf "$place/$suite/saltus"
  git clone -q . "$place/$suite/saltus"
  timed "$suite, scripts/reproduce.sh" chroot "$place/$suite" /saltus/scripts/reproduce.sh
  [[ -n $quick ]] || timed "$suite, scripts/test.sh" chroot "$place/$suite" /saltus/scripts/test.sh
  timed "$suite, wheel" chroot "$place/$suite" sh -c "cd /saltus && rm -rf made && SALTUS_CMAKE_BUILD=build/release \
    python3 -m pip wheel . --no-build-isolation --no-deps --no-index -w made"
  bare "$place/$suite-user" "$suite"
  rm -rf "$place/$suite-user/saltus"
  mkdir "$place/$suite-user/saltus"
  cp -r "$place/$suite/saltus/made" "$place/$suite/saltus/"{problems,scripts} "$place/$suite-user/saltus/"
  chroot "$place/$suite-user" env DEBIAN_FRONTEND=noninteractive sh -c \
    "apt-get -q update && apt-get -q -y install --no-install-recommends python3-numpy python3-pip" >"$place/log" 2>&1 ||
    { tail "$place/log"; exit 1; }
  timed "$suite, the wheel on a bare machine" chroot "$place/$suite-user" sh -c \
    "cd /saltus && python3 -m pip install --no-index --no-deps --break-system-packages --force-reinstall made/*.whl &&
     python3 scripts/check_wheel.py problems/two_balls.yaml"
done
