#!/usr/bin/env python3
"""The tables of README.md and docs/ are those that scripts/reference.py writes. usage: reference_test.py --build=DIR"""

import pathlib
import subprocess
import sys

SCRIPT = pathlib.Path(__file__).resolve().parents[2] / "scripts" / "reference.py"
sys.exit(subprocess.run([sys.executable, SCRIPT, "--check", *sys.argv[1:]], check=False).returncode)
