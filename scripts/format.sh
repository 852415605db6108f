#!/usr/bin/env bash
# usage: scripts/format.sh [--check]
# Formats every C++ file; with --check only says which are not formatted, and fails if any.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

action=(-i)
case "$*" in
  '') ;;
  --check) action=(--dry-run --Werror) ;;
  *)
    echo "usage: scripts/format.sh [--check]" >&2
    exit 2
    ;;
esac
find bench include problems python src tests \( -name '*.h' -o -name '*.cc' \) -print0 | xargs -0 clang-format "${action[@]}"
