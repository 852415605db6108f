#!/usr/bin/env bash
# usage: scripts/test.sh [flags of cmake...]
# From a bare Debian to tested: installs packages, builds, runs every test.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

jobs=$(nproc)
# With three simulators of others, to audit: 0.9 MB of packages.
scripts/install_packages.sh libbox2d-dev libchipmunk-dev libode-dev python3
# And one of npm's, where there is npm: 10 MB.
if command -v npm >/dev/null && [[ ! -d engines/node_modules/planck ]]; then
  npm install --prefix engines --omit=optional --no-audit --no-fund --no-package-lock --ignore-scripts ||
    echo "test: going on without planck" >&2
fi
# In the folder of scripts/reproduce.sh, which compiles none of the library anew.
cmake --preset release -DSALTUS_BUILD_ENGINES=ON "$@"
cmake --build --preset release -j "$jobs"
ctest --preset release --output-on-failure --no-tests=error -j "$jobs"
