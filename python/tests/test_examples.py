"""The notebooks among the pages and the examples in docstrings run, and print what they show."""

import doctest
import importlib.util
import os
import pathlib

import pytest

import saltus

ROOT = pathlib.Path(__file__).parents[2]


def printed_in(notebook):
    """Standard output, by cell."""
    return [
        "".join(output["text"] for output in cell.get("outputs", []) if output.get("name") == "stdout")
        for cell in notebook.cells
    ]


@pytest.mark.parametrize("path", sorted((ROOT / "docs").rglob("*.ipynb")), ids=lambda path: path.stem)
def test_notebook(path, tmp_path, monkeypatch):
    nbclient = pytest.importorskip("nbclient", reason="python3-nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="python3-nbformat is not installed")
    for package in ("ipykernel", "matplotlib"):
        pytest.importorskip(package, reason=f"python3-{package} is not installed")
    for variable in ("JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    # Debian's kernel is its own Python, whatever runs this.
    here = str(pathlib.Path(saltus.__file__).parents[1])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))
    # Figures are outputs of cells, which MPLBACKEND=agg would not make them.
    monkeypatch.delenv("MPLBACKEND", raising=False)
    notebook = nbformat.read(path, as_version=4)
    stored = printed_in(notebook)
    assert any(stored)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(path.parent)}}).execute()
    assert printed_in(notebook) == stored
    assert [len(cell.get("outputs", [])) > 0 for cell in notebook.cells] == [
        len(cell.get("outputs", [])) > 0 for cell in nbformat.read(path, as_version=4).cells
    ]


def test_examples_in_docstrings(monkeypatch):
    monkeypatch.chdir(ROOT)
    modules = [saltus]
    if importlib.util.find_spec("torch"):
        modules.append(importlib.import_module("saltus.torch"))
    for module in modules:
        found = doctest.testmod(module)
        assert found.attempted > 3 and found.failed == 0, module.__name__
