"""The examples of the notebook and of docstrings run, and say what they should."""

import doctest
import importlib.util
import os
import pathlib
import re

import pytest

import saltus

EXAMPLES = pathlib.Path(__file__).parents[1] / "examples"
ROOT = pathlib.Path(__file__).parents[2]


def printed_in(notebook):
    """Standard output, by cell."""
    return [
        "".join(output["text"] for output in cell.get("outputs", []) if output.get("name") == "stdout")
        for cell in notebook.cells
    ]


def test_own_simulator(tmp_path, monkeypatch):
    nbclient = pytest.importorskip("nbclient", reason="python3-nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="python3-nbformat is not installed")
    for package in ("ipykernel", "matplotlib"):
        pytest.importorskip(package, reason=f"python3-{package} is not installed")
    for variable in ("JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    # Debian's kernel is its own Python, whatever runs this.
    here = str(pathlib.Path(saltus.__file__).parents[1])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.read(EXAMPLES / "own_simulator.ipynb", as_version=4)
    stored = printed_in(notebook)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(EXAMPLES)}}).execute()
    assert printed_in(notebook) == stored
    printed = "\n".join(stored)
    # The published table, but for a solver's error in one of its losses.
    assert float(re.search(r"largest difference: (\S+)", printed)[1]) < 5e-4
    assert re.search(r"^direct +wrong +2\.0014 +2\.0014$", printed, re.M)
    assert "WrongGradient: mine: the gradient is wrong" in printed
    optimised, optimum = map(float, re.search(r"-> (\S+); the optimum is (\S+)", printed).groups())
    assert optimum < optimised < optimum + 0.05


def test_examples_in_docstrings(monkeypatch):
    monkeypatch.chdir(ROOT)
    modules = [saltus]
    if importlib.util.find_spec("torch"):
        modules.append(importlib.import_module("saltus.torch"))
    for module in modules:
        found = doctest.testmod(module)
        assert found.attempted > 3 and found.failed == 0, module.__name__
