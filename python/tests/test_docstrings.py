"""The docstrings of the module are valid pages of the reference."""

import importlib.util
import inspect

import pytest
from conftest import SOURCE

import saltus

docutils_core = pytest.importorskip("docutils.core")
napoleon = pytest.importorskip("sphinx.ext.napoleon")


def public():
    """Yields the name and the docstring of each function, class and method that the reference shows."""
    for name in dir(saltus):
        thing = getattr(saltus, name)
        if name.startswith("_") or inspect.ismodule(thing) or not callable(thing):
            continue
        members = {f"{name}.{key}": value for key, value in vars(thing).items() if not key.startswith("_")} if inspect.isclass(thing) else {}
        for where, of in {name: thing, **members}.items():
            if inspect.getdoc(of) and (callable(of) or isinstance(of, property)):
                yield where, inspect.getdoc(of)


def test_docstrings_have_no_errors_of_markup():
    specification = importlib.util.spec_from_file_location("conf", SOURCE / "docs" / "conf.py")
    conf = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(conf)
    faults, count = [], 0
    for name, text in public():
        lines = napoleon.GoogleDocstring(text, what="class" if name[0].isupper() else "function").lines()
        conf.keep_lines(None, "function", name, None, None, lines)
        page = docutils_core.publish_doctree("\n".join(lines), settings_overrides={"report_level": 2, "warning_stream": False})
        count += 1
        messages = [node.astext() for node in page.findall() if node.tagname == "system_message" and node["level"] >= 2]
        faults += [f"{name}: {message}" for message in messages if "irective" not in message]  # Sphinx adds some directives
    assert count > 50
    assert not faults
