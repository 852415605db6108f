#!/usr/bin/env bash
# usage: scripts/check_packages.sh [build folder]
# Makes the Debian packages and the Python wheel from a build (build/release unless given), unpacks them into a clean folder
# and runs the examples of the README with the unpacked programs, the unpacked library and the unpacked module.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source=$PWD
build=$(realpath "${1:-build/release}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/made" "$work/root" "$work/site" "$work/user"

(cd "$build" && cpack -B "$work/made") >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }
for package in "$work"/made/*.deb; do
  echo "== ${package##*/}, $(stat -c %s "$package") bytes, $(dpkg-deb --field "$package" Installed-Size) KiB installed:"
  dpkg-deb --field "$package" Depends
  dpkg-deb -x "$package" "$work/root"
done
for name in libsaltus0 saltus libsaltus-dev; do
  compgen -G "$work/made/${name}_*.deb" >/dev/null || { echo "no package $name"; exit 1; }
done
# The programs load the libraries of the packages, not those of the build folder.
if [[ $(ldd "$work/root/usr/bin/saltus_audit" | grep -cE "libsaltus[a-z_]*\.so\.[0-9]+ => $work/root/") != 2 ]]; then
  ldd "$work/root/usr/bin/saltus_audit"
  exit 1
fi

echo "== the programs"
scene=$work/root/usr/share/saltus/problems/two_balls.yaml
cd "$work/user"
"$work/root/usr/bin/saltus_audit" --scene="$scene" --contact=direct,toi_velocity,event --progress=none >audit.txt
for line in "direct .*wrong" "toi_velocity .*consistent" "event .*right"; do
  grep -qE "^$line" audit.txt || { cat audit.txt; echo "no verdict: $line"; exit 1; }
done
"$work/root/usr/bin/saltus_solve" --scene="$scene" --contact=event --solver=ceres_event --progress=none >solve.txt
grep -q "1.396542489" solve.txt || { cat solve.txt; exit 1; }

echo "== the library"
# tests/consumer with the unpacked library, from which one of its programs is enough.
cmake -S "$source/tests/consumer" -B consumer -DCMAKE_BUILD_TYPE=Release -DCMAKE_PREFIX_PATH="$work/root/usr" >log 2>&1 ||
  { cat log; exit 1; }
grep -q "saltus_DIR:PATH=$work/root" consumer/CMakeCache.txt || { echo "another saltus was found"; exit 1; }
target=$(sed -nE 's/^add_executable\((\S+) main\.cc.*/\1/p' "$source/tests/consumer/CMakeLists.txt")
cmake --build consumer --target "$target" >log 2>&1 || { tail -30 log; exit 1; }
"./consumer/$target" "$scene"

if ! compgen -G "$build/python/saltus/_saltus.*.so" >/dev/null; then
  echo "== no wheel: the Python module is not built"
  exit 0
fi
echo "== the wheel"
python=$(sed -nE 's/^Python_EXECUTABLE:[A-Z]+=//p;s/^_Python_EXECUTABLE:INTERNAL=//p' "$build/CMakeCache.txt" | head -1)
# From a copy: setuptools writes into the folder that it builds from.
mkdir "$work/source"
cp -r "$source"/{CMakeLists.txt,README.md,LICENSE,pyproject.toml,setup.py,python} "$work/source"
(cd "$work/source" && SALTUS_CMAKE_BUILD=$build "$python" -m pip wheel . --no-build-isolation --no-deps --no-index -q \
  -w "$work/made") >log 2>&1 || { tail -30 log; exit 1; }
wheel=("$work"/made/saltus-*.whl)
"$python" -m zipfile -e "${wheel[0]}" "$work/site"
echo "${wheel[0]##*/}, $(stat -c %s "${wheel[0]}") bytes, with $(find "$work/site/saltus/libs" -name '*.so*' | wc -l) libraries"
# The wheel carries all libraries that it loads, except those of glibc and of GCC.
others=$(ldd "$work"/site/saltus/_saltus.*.so | sed -nE 's/^\s+(\S+) => (\S+).*/\1 \2/p' |
  grep -vE "^(lib(c|m|dl|rt|pthread|gcc_s|stdc\+\+)\.so|ld-linux)| $work/site/saltus/" || true)
if [[ -n $others ]]; then
  echo "the wheel loads libraries of this machine: $others"
  exit 1
fi
for site in "$work/site" "$work/root/usr/lib/python3/dist-packages"; do
  PYTHONPATH=$site "$python" "$source/scripts/check_wheel.py" "$scene" "$site"
done
echo "The packages work."
