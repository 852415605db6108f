#!/usr/bin/env python3
"""docs/reference/support.md is what scripts/support_tables.py writes. usage: support_test.py --build=DIR"""

import pathlib
import subprocess
import sys

SCRIPT = pathlib.Path(__file__).resolve().parents[2] / "scripts" / "support_tables.py"
sys.exit(subprocess.run([sys.executable, SCRIPT, "--check", *sys.argv[1:]], check=False).returncode)
