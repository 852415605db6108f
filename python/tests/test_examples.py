"""The notebooks among the pages and the examples in docstrings run, and print what they show."""

import doctest
import importlib.util
import os
import pathlib

import numpy as np
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
    for other in ("torch", "jax"):
        if importlib.util.find_spec(other):
            modules.append(importlib.import_module(f"saltus.{other}"))
    for module in modules:
        found = doctest.testmod(module)
        assert found.attempted > 3 and found.failed == 0, module.__name__


class TestLearnPolicy:
    @pytest.fixture(autouse=True)
    def example(self, monkeypatch):
        monkeypatch.syspath_prepend(ROOT / "python" / "examples")
        return importlib.import_module("learn_policy")

    def test_gradient_is_that_of_differences(self, example, two_balls):
        task = example.Task(two_balls, "event")
        random = np.random.default_rng(3)
        starts = task.starts(2, random)
        policy = random.normal(0, 0.1, (example.features(starts).shape[1], 2 * example.KNOTS))
        policy[0] = 3
        _, gradient = task.loss_and_gradient(policy, starts)
        for entry in [(0, 0), (0, 5), (2, 3), (9, 8)]:
            by = np.zeros_like(policy)
            by[entry] = 1e-5
            difference = (task.loss(policy + by, starts) - task.loss(policy - by, starts)) / 2e-5
            assert gradient[entry] == pytest.approx(difference, rel=1e-6, abs=1e-8)

    def test_exact_gradients_learn_to_strike_and_those_of_direct_do_not(self, example, two_balls):
        """Against the optima of the minimum principle."""
        exact = example.Task(two_balls, "event")
        starts = exact.starts(20, np.random.default_rng(0))
        learned = exact.loss(example.learn(exact, 60, 8), starts)
        optimum = example.optimum(two_balls, starts)
        assert optimum < learned < 1.05 * optimum
        assert exact.loss(example.learn(example.Task(two_balls, "direct"), 60, 8), starts) > 1.3 * optimum
