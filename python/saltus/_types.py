"""Names for what signatures share, and the types of options."""

from __future__ import annotations

from typing import Any, Callable

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


def expect(kind: str, **options: Any) -> None:
    """Raises TypeError, with its name, for an option that is not of this kind."""
    for name, value in options.items():
        if not _KINDS[kind](value):
            raise TypeError(f"{name}: found {type(value).__name__}, expected {kind}")
