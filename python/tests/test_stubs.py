"""The stub of the extension module has what the module has, and types are right."""

import ast
import importlib.util
import inspect
import os
import pathlib
import subprocess
import sys

import pytest
from conftest import BIN, SOURCE

import saltus
from saltus import _saltus

# A program that uses the package, for mypy.
USER = """
import numpy as np
import saltus

scene = saltus.load_scene("two_balls.yaml").replace(steps=96)
simulation = saltus.Simulation(scene, "event")
loss, gradient = simulation.loss_and_gradient(simulation.initial_guess, out=np.empty(simulation.shape))
step = simulation.initial_guess - 0.1 * gradient
run: saltus.Run = saltus.solve(scene, "event", "gd", callback=lambda iteration, loss: loss > 1.4)
saltus.audit(scene, simulate=lambda scene, initial, control, dt: initial).raise_if_wrong()
"""


def declared():
    """Names in the stub, those of a class after its name."""
    tree = ast.parse(pathlib.Path(saltus.__file__).with_name("_saltus.pyi").read_text(encoding="utf-8"))
    names = set()
    for node in tree.body:
        if isinstance(node, ast.AnnAssign):
            names.add(node.target.id)
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names.update(f"{node.name}.{child.name}" for child in node.body)
    return names


def test_stub_and_module_have_the_same_names():
    found = {"__version__"}
    for name, value in vars(_saltus).items():
        if name.startswith("_"):
            continue
        found.add(name)
        if inspect.isclass(value):
            own = {"__init__", "__call__", "__eq__", "__len__"}
            found.update(f"{name}.{of}" for of in vars(value) if of in own or not of.startswith("__"))
    assert found - {name for name in found if name.endswith("._pybind11_conduit_v1_")} == declared()


def test_all_that_is_public_is_documented():
    for name in saltus.__all__:
        if name == "__version__":
            continue
        assert inspect.getdoc(getattr(saltus, name)), name
        assert name in saltus.__doc__ or name in ("Audit", "Fit", "Gradient", "Rollout", "Run") or name.startswith("Hybrid"), name


def test_mypy_finds_nothing(tmp_path):
    """The package and the stub, strictly; torch.py and jax.py where these packages are, whose types they need."""
    pytest.importorskip("mypy", reason="mypy is not installed")
    files = [path for path in (SOURCE / "python" / "saltus").glob("*.py*") if path.suffix in (".py", ".pyi")]
    missing = [f"{other}.py" for other in ("torch", "jax") if importlib.util.find_spec(other) is None]
    files = [path for path in files if path.name not in missing]
    user = tmp_path / "user.py"
    user.write_text(USER, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", f"--cache-dir={BIN.parent / 'mypy_cache'}", *map(str, files), str(user)],
        capture_output=True, text=True, check=False, env={**os.environ, "MYPYPATH": str(SOURCE / "python")},
    )
    assert done.returncode == 0, done.stdout + done.stderr
