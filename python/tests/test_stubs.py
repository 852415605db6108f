"""The stub of the extension module has what the module has."""

import ast
import inspect
import pathlib

import saltus
from saltus import _saltus


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
            own = {"__init__", "__call__", "__eq__"}
            found.update(f"{name}.{of}" for of in vars(value) if of in own or not of.startswith("__"))
    assert found - {name for name in found if name.endswith("._pybind11_conduit_v1_")} == declared()


def test_all_that_is_public_is_documented():
    for name in saltus.__all__:
        if name == "__version__":
            continue
        assert inspect.getdoc(getattr(saltus, name)), name
        assert name in saltus.__doc__ or name in ("Audit", "Gradient", "Rollout", "Run"), name
