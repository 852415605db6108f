#!/usr/bin/env bash
# usage: scripts/install_packages.sh [more packages...]
# Installs the Debian 12 packages that saltus is built from and runs with. Does nothing if all are there.
set -euo pipefail

packages=(
  g++ mold cmake ninja-build pkg-config
  libceres-dev libeigen3-dev libgflags-dev libgoogle-glog-dev # the solver, and what it is made of
  coinor-libipopt-dev # the optional solver ipopt
  libboost-dev # interval arithmetic, UTF-8
  libyaml-cpp-dev nlohmann-json3-dev libzip-dev libtbb-dev
  libgtest-dev libgmock-dev libbenchmark-dev
  python3-dev pybind11-dev python3-numpy # the Python module
  python3-pytest python3-scipy python3-matplotlib # its tests; those with python3-torch, python3-distributed and mypy are skipped without
  python3-nbclient python3-ipykernel # the example notebook
  python3-jsonschema python3-sphinx codespell # the tests of schemas/, docs/ and docstrings
  universal-ctags # the test of names that are defined twice
  dpkg-dev patchelf python3-pip python3-setuptools python3-wheel # the test of packages
  "$@"
)

if ! command -v dpkg-query >/dev/null; then
  echo "install_packages: this is not a Debian system; install the equivalents of: ${packages[*]}" >&2
  exit 1
fi

installed=$(dpkg-query -W -f '${db:Status-Status}:${Package}\n' "${packages[@]}" 2>/dev/null || true)
missing=()
for package in "${packages[@]}"; do
  grep -qxF "installed:$package" <<<"$installed" || missing+=("$package")
done
if ((${#missing[@]} == 0)); then exit 0; fi

as_root=()
if ((EUID != 0)); then
  if ! command -v sudo >/dev/null; then
    echo "install_packages: need root or sudo to install: ${missing[*]}" >&2
    exit 1
  fi
  as_root=(sudo)
fi

echo "Installing: ${missing[*]}" >&2
log=$(mktemp)
trap 'rm -f "$log"' EXIT
apt_get() {
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o DPkg::Lock::Timeout=120 "$@" >"$log" 2>&1
}
# Stale lists may still do, so a failed update alone is no reason to stop.
apt_get update || { echo "install_packages: apt-get update failed, going on with the lists there are:"; cat "$log"; } >&2
if ! apt_get install --no-install-recommends "${missing[@]}"; then
  cat "$log" >&2
  echo "install_packages: could not install: ${missing[*]}" >&2
  exit 1
fi
