"""Names for what signatures share, the types of options, and arguments by name."""

from __future__ import annotations

import inspect
import os
from typing import Any, Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


_KINDS: dict[str, Callable[[Any], bool]] = {
    "a whole number": lambda value: _is_number(value) and not isinstance(value, (float, np.floating)),
    "a number": _is_number,
    "text": lambda value: isinstance(value, str),
    "True or False": lambda value: isinstance(value, (bool, np.bool_)),
    "a callable": lambda value: value is None or callable(value),
}


class Remade:
    """An object that is copied and pickled by the arguments from which an equal object is made."""

    _arguments: dict[str, Any]

    def __reduce__(self) -> Any:
        return (_make, (type(self), self._arguments))


def _make(kind: type, arguments: dict[str, Any]) -> Any:
    return kind(**arguments)


def expect(kind: str, **options: Any) -> None:
    """Raises TypeError, with its name, for an option that is not of this kind."""
    for name, value in options.items():
        if not _KINDS[kind](value):
            raise TypeError(f"{name}: found {type(value).__name__}, expected {kind}")


def expect_none_of(function: Callable[..., Any], **options: Any) -> None:
    """Raises ValueError, with its name, for an option of a function that a HybridProblem does not take, unless it has its
    default."""
    for name, value in options.items():
        default, plain = inspect.signature(function).parameters[name].default, isinstance(value, (bool, int, float, str))
        if value is default or (plain and value == default):
            continue
        remedy = "; solver= names a solver" if name == "contact" else ""
        found = repr(value) if plain else type(value).__name__
        raise ValueError(f"{name}: found {found}, expected none, as a HybridProblem does not take it{remedy}")


def expect_path(what: str, path: Any, otherwise: str = "") -> str:
    """Returns a path as text; raises TypeError for what is no path."""
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"{what}: found {type(path).__name__}, expected the path of a file{otherwise}")
    return os.fspath(path)


def expect_names(**options: Any) -> list[str]:
    """Returns the names that an option has, one as text or several; raises TypeError for anything that is no text."""
    names = []
    for option, value in options.items():
        several = isinstance(value, Iterable) and not isinstance(value, str)
        for name in value if several else [value]:
            if not isinstance(name, str):
                raise TypeError(f"{option}: found {type(name).__name__}, expected text: a name, or a list of names")
            names.append(name)
    return names


def expect_int(**options: Any) -> None:
    """Raises TypeError for an option that is no whole number, and ValueError for one beyond the range of int."""
    expect("a whole number", **options)
    for name, value in options.items():
        if not -(2**31) <= value < 2**31:
            raise ValueError(f"{name}: found {value}, expected a whole number with a magnitude below {2**31}")


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]


def parameters_of(function: Callable[..., Any]) -> dict[str, inspect.Parameter] | None:
    """Returns the parameters of a function by name; None for one without a signature."""
    try:
        return dict(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return None


def asked_for(
    function: Callable[..., Any],
    known: Mapping[str, Any],
    order: Sequence[str],
    refused: Mapping[str, str] | None = None,
) -> tuple[list[Any], dict[str, Any]]:
    """Returns the positional and the keyword arguments of a call of a function: those of the known values that the names
    of its parameters ask for.

    A function with other names gets the values in the given order, if it has as many parameters and none of them has a
    known name in another place. A parameter with a default and another name keeps its default.

    Args:
        refused: names with the reason why there is no such value.

    Raises:
        ValueError: a parameter has a name that is not known, or a known one in an ambiguous place.
    """
    in_order = [known[name] for name in order]
    parameters = parameters_of(function)
    if parameters is None or any(p.kind is p.VAR_POSITIONAL for p in parameters.values()):
        return in_order, {}
    asked = {name: p for name, p in parameters.items()
             if p.kind is not p.VAR_KEYWORD and (p.default is p.empty or name in known)}
    for name in asked:
        if refused is not None and name in refused:
            raise ValueError(f"found an argument {name!r}: {refused[name]}")
    unknown = [name for name in asked if name not in known]
    if not unknown:
        positional = [known[name] for name, p in asked.items() if p.kind is p.POSITIONAL_ONLY]
        return positional, {name: known[name] for name, p in asked.items() if p.kind is not p.POSITIONAL_ONLY}
    places = [name for name, p in asked.items() if p.kind is not p.KEYWORD_ONLY]
    if len(places) == len(asked) == len(order) and all(
        name == place or name not in known for name, place in zip(places, order)
    ):
        return in_order, {}
    names = [*order, *(name for name in known if name not in order)]
    expected = f"some of {_listed(names)} by these names"
    if order:
        expected += f", or {len(order)} arguments of other names for ({', '.join(order)}), in this order"
    raise ValueError(f"found an argument {unknown[0]!r}, expected {expected}")


class Closed:
    """A base of classes that refuse attributes which they do not have, such as misspelt ones."""

    _attributes: tuple[str, ...] = ()

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._attributes and not name.startswith("_"):
            raise AttributeError(
                f"this {type(self).__name__} has no attribute {name!r}; it has {', '.join(self._attributes)}"
            )
        super().__setattr__(name, value)
