"""Recording of ordinary functions as expression graphs, which C++ evaluates and differentiates."""

from __future__ import annotations

import contextlib
import math
import threading
from typing import Any, Callable, Iterator, Sequence

import numpy as np

# An operation, its operands (numbers of earlier nodes, -1 for none; of an input its number), and the value of a constant.
_Node = "tuple[str, int, int, int, float]"

_BRANCH = (
    "the function decides by a value which it does not have yet: it is called once with symbols, and recorded; "
    "expected saltus.where(condition, a, b) in place of 'if', 'and', 'or', 'not', min(), max() and the like"
)
_NUMBER = (
    "the function turns a symbol into a number: it is called once with symbols, and recorded; expected arithmetic, "
    "functions of math and numpy, and saltus.where"
)


class Tape:
    """What is recorded: nodes in order, each one the result of an operation on nodes before it."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self._known: dict[Any, int] = {}

    def add(self, operation: str, a: int = -1, b: int = -1, c: int = -1, value: float = 0.0) -> int:
        key = (operation, a, b, c, value, math.copysign(1.0, value))
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append((operation, a, b, c, value))
        return self._known[key]

    def inputs(self, first: int, count: int) -> Any:
        """Symbols for inputs, as an array of objects."""
        symbols = np.empty(count, dtype=object)
        for i in range(count):
            symbols[i] = Expression(self, self.add("input", first + i))
        return symbols

    def index_of(self, value: Any) -> int:
        """The node of an expression or of a number."""
        if isinstance(value, Expression):
            if value._tape is not self:
                raise ValueError("found a symbol of another recording, expected those that the function was called with")
            return value._index
        if isinstance(value, np.ndarray) and value.shape == ():
            return self.index_of(value[()])
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise TypeError(f"found {type(value).__name__}, expected a number or an expression of the arguments")
        return self.add("constant", value=float(value))


class Expression:
    """A value of a function that is being recorded."""

    __slots__ = ("_index", "_tape")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, tape: Tape, index: int):
        self._tape, self._index = tape, index

    def _apply(self, operation: str, *operands: Any) -> Expression:
        kind = Condition if operation in _CONDITIONS else Expression
        return kind(self._tape, self._tape.add(operation, *(self._tape.index_of(operand) for operand in operands)))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        function = _UFUNCS.get(ufunc.__name__)
        if method != "__call__" or keywords or function is None:
            raise TypeError(f"numpy.{ufunc.__name__} cannot be recorded; it can: {', '.join(sorted(_UFUNCS))}")
        # Numbers of numpy would ask this method again.
        plain = [value.item() if isinstance(value, np.generic) else value for value in inputs]
        if not any(isinstance(value, (np.ndarray, list, tuple)) for value in plain):
            return function(*plain)
        arrays = np.broadcast_arrays(*(_as_array(value) for value in plain))
        result = np.empty(arrays[0].shape, dtype=object)
        for place in np.ndindex(result.shape):
            result[place] = function(*(array[place] for array in arrays))
        return result[()] if result.shape == () else result

    def __bool__(self) -> bool:
        raise TypeError(_BRANCH)

    def __float__(self) -> float:
        raise TypeError(_NUMBER)

    __int__ = __index__ = __complex__ = __round__ = __float__  # type: ignore[assignment]

    def __add__(self, other: Any) -> Any:
        return _binary("add", self, other)

    def __radd__(self, other: Any) -> Any:
        return _binary("add", other, self)

    def __sub__(self, other: Any) -> Any:
        return _binary("subtract", self, other)

    def __rsub__(self, other: Any) -> Any:
        return _binary("subtract", other, self)

    def __mul__(self, other: Any) -> Any:
        return _binary("multiply", self, other)

    def __rmul__(self, other: Any) -> Any:
        return _binary("multiply", other, self)

    def __truediv__(self, other: Any) -> Any:
        return _binary("divide", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _binary("divide", other, self)

    def __pow__(self, other: Any) -> Any:
        return _binary("power", self, other)

    def __rpow__(self, other: Any) -> Any:
        return _binary("power", other, self)

    def __floordiv__(self, other: Any) -> Any:
        return _floor(self / other)

    def __rfloordiv__(self, other: Any) -> Any:
        return _floor(other / self)

    def __mod__(self, other: Any) -> Any:
        return self - other * _floor(self / other)

    def __rmod__(self, other: Any) -> Any:
        return other - self * _floor(other / self)

    def __neg__(self) -> Expression:
        return self._apply("negate", self)

    def __pos__(self) -> Expression:
        return self

    def __abs__(self) -> Expression:
        return self._apply("abs", self)

    def __lt__(self, other: Any) -> Any:
        return _binary("less", self, other)

    def __le__(self, other: Any) -> Any:
        return _binary("less_equal", self, other)

    def __gt__(self, other: Any) -> Any:
        return _binary("less", other, self)

    def __ge__(self, other: Any) -> Any:
        return _binary("less_equal", other, self)

    def __eq__(self, other: Any) -> Any:
        return (self <= other) & (self >= other)

    def __ne__(self, other: Any) -> Any:
        return ~(self == other)

    def conjugate(self) -> Expression:
        return self

    def clip(self, low: Any, high: Any, out: Any = None) -> Any:
        return _minimum(_maximum(self, low), high)

    def __repr__(self) -> str:
        operation, a, b, c, value = self._tape.nodes[self._index]
        if operation == "constant":
            return repr(value)
        operands = [f"#{operand}" for operand in (a, b, c) if operand >= 0]
        return f"<{operation}({', '.join(operands)})>"


class Condition(Expression):
    """The result of a comparison, for saltus.where; conditions are joined by & and |, and negated by ~."""

    __slots__ = ()

    def __and__(self, other: Any) -> Expression:
        return other if other is True else self._apply("and", self, other)

    def __or__(self, other: Any) -> Expression:
        return self._apply("or", self, other)

    def __invert__(self) -> Expression:
        return self._apply("not", self)


_CONDITIONS = ("less", "less_equal", "and", "or", "not")


def _as_array(value: Any) -> Any:
    array = np.empty((), dtype=object)
    if isinstance(value, Expression):
        array[()] = value
        return array
    return np.asarray(value, dtype=object)


def _binary(operation: str, a: Any, b: Any) -> Any:
    for value in (a, b):
        if isinstance(value, (np.ndarray, list, tuple)):
            return NotImplemented
        if not isinstance(value, (Expression, int, float, np.integer, np.floating)):
            return NotImplemented
    return (a if isinstance(a, Expression) else b)._apply(operation, a, b)


def _one(operation: str, of_number: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def function(value: Any) -> Any:
        return value._apply(operation, value) if isinstance(value, Expression) else of_number(value)

    return function


def _unless_recorded(recorded: Callable[..., Any], of_numbers: Callable[..., Any]) -> Callable[..., Any]:
    def function(*values: Any) -> Any:
        if any(isinstance(value, Expression) for value in values):
            return recorded(*values)
        return of_numbers(*values)

    return function


def where(condition: Any, a: Any, b: Any) -> Any:
    """`a` where the condition holds and `b` elsewhere, in functions that are recorded; both are evaluated.

    Conditions are comparisons, joined by ``&`` and ``|``, negated by ``~``. Arrays and lists are chosen entry by entry.
    Of numbers it is numpy.where.
    """
    values = [_as_array(value) for value in (condition, a, b)]
    if not any(isinstance(entry, Expression) for value in values for entry in value.flat):
        return np.where(condition, a, b)

    def choose(test: Any, yes: Any, no: Any) -> Any:
        if not isinstance(test, Expression):
            return yes if test else no
        return Expression._apply(test, "where", test, yes, no)

    arrays = np.broadcast_arrays(*values)
    result = np.empty(arrays[0].shape, dtype=object)
    for place in np.ndindex(result.shape):
        result[place] = choose(*(array[place] for array in arrays))
    return result[()] if result.shape == () else result


_floor = _one("floor", math.floor)


def _minimum(a: Any, b: Any) -> Any:
    return where(a <= b, a, b)


def _maximum(a: Any, b: Any) -> Any:
    return where(a >= b, a, b)


def _atan2(y: Any, x: Any) -> Any:
    return (y if isinstance(y, Expression) else x)._apply("atan2", y, x)


def _hypot(*values: Any) -> Any:
    return _FUNCTIONS["sqrt"](sum(value * value for value in values))


def _copysign(a: Any, b: Any) -> Any:
    return where(b >= 0, abs(a), -abs(a))


def _cbrt(a: Any) -> Any:
    return where(a < 0, -((-a) ** (1 / 3)), a ** (1 / 3))


_SIMPLE = "sqrt exp expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh erf floor".split()
_FUNCTIONS: dict[str, Callable[..., Any]] = {name: _one(name, getattr(math, name)) for name in _SIMPLE}
_one_argument_log = _FUNCTIONS["log"]


def _log(a: Any, *base: Any) -> Any:
    return _one_argument_log(a) / _one_argument_log(base[0]) if base else _one_argument_log(a)


_RECORDED: dict[str, Callable[..., Any]] = {
    "log": _log,
    "log2": lambda a: _log(a) / math.log(2.0),
    "log10": lambda a: _log(a) / math.log(10.0),
    "fabs": abs,
    "pow": lambda a, b: a**b,
    "atan2": _atan2,
    "hypot": _hypot,
    "copysign": _copysign,
    "ceil": lambda a: -_floor(-a),
    "fmod": lambda a, b: a - b * where(a / b >= 0, _floor(a / b), -_floor(-(a / b))),
    "degrees": lambda a: a * (180 / math.pi),
    "radians": lambda a: a * (math.pi / 180),
    "cbrt": _cbrt,
    "exp2": lambda a: 2.0**a,
}
# What stands in the place of the functions of math while a function is recorded.
_MATH = {
    **{name: _FUNCTIONS[name] for name in _SIMPLE},
    **{name: _unless_recorded(f, getattr(math, name)) for name, f in _RECORDED.items() if hasattr(math, name)},
}
_UFUNCS: dict[str, Callable[..., Any]] = {
    **{name: _FUNCTIONS[name] for name in _SIMPLE},
    **_RECORDED,
    **{f"arc{name[1:]}": _FUNCTIONS[name] for name in _SIMPLE if name.startswith("a")},
    "arctan2": _atan2,
    "absolute": abs,
    "sign": _one("sign", np.sign),
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "true_divide": lambda a, b: a / b,
    "floor_divide": lambda a, b: a // b,
    "remainder": lambda a, b: a % b,
    "power": lambda a, b: a**b,
    "float_power": lambda a, b: a**b,
    "square": lambda a: a * a,
    "reciprocal": lambda a: 1.0 / a,
    "negative": lambda a: -a,
    "positive": lambda a: a,
    "conjugate": lambda a: a,
    "deg2rad": _RECORDED["radians"],
    "rad2deg": _RECORDED["degrees"],
    "maximum": _maximum,
    "minimum": _minimum,
    "fmax": _maximum,
    "fmin": _minimum,
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "greater": lambda a, b: a > b,
    "greater_equal": lambda a, b: a >= b,
    "logical_and": lambda a, b: a & b,
    "logical_or": lambda a, b: a | b,
    "logical_not": lambda a: ~a,
    "bitwise_and": lambda a, b: a & b,
    "bitwise_or": lambda a, b: a | b,
    "invert": lambda a: ~a,
}
# Of arrays of objects numpy calls methods of these names.
for _name, _function in _UFUNCS.items():
    if not hasattr(Expression, _name):
        setattr(Expression, _name, (lambda f: lambda self, *rest: f(self, *rest))(_function))

_lock = threading.RLock()


@contextlib.contextmanager
def _math_records(function: Any) -> Iterator[None]:
    """Within it, math has functions that take expressions, also where a module has imported them by name."""
    originals = {name: getattr(math, name) for name in _MATH}
    by_identity = {id(original): _MATH[name] for name, original in originals.items()}
    names = getattr(function, "__globals__", {})
    changed = {key: value for key, value in names.items() if id(value) in by_identity}
    with _lock:
        try:
            for name, replacement in _MATH.items():
                setattr(math, name, replacement)
            names.update({key: by_identity[id(value)] for key, value in changed.items()})
            yield
        finally:
            for name, original in originals.items():
                setattr(math, name, original)
            names.update(changed)


def call(function: Any, *arguments: Any, **keywords: Any) -> Any:
    """What the function returns for symbols."""
    with _math_records(function):
        return function(*arguments, **keywords)


def outputs(tape: Tape, values: Any, expected: int | None = None) -> tuple[int, list[Any], list[int]]:
    """What C++ takes of a recording: nodes and outputs, given what the function returned: one value or several."""
    if values is None:
        raise ValueError("found nothing that the function returns, expected numbers: a return is missing")
    if isinstance(values, Expression) or not isinstance(values, (Sequence, np.ndarray)):
        values = [values]
    flat = list(np.ravel(_as_array(values)))
    if expected is not None and len(flat) != expected:
        raise ValueError(f"found {len(flat)} numbers, expected {expected}")
    numbers = [tape.index_of(value) for value in flat]
    return (len(numbers), tape.nodes, numbers)
