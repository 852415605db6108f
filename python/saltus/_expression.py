"""Recording of ordinary functions as expression graphs, which C++ evaluates and differentiates."""

from __future__ import annotations

import abc
import builtins
import functools
import math
import sys
import types
from typing import Any, Callable, Sequence

import numpy as np

# An operation, its operands (numbers of earlier nodes, -1 for none; of an input its number), and the value of a constant.
_Node = "tuple[str, int, int, int, float]"

_BRANCH = (
    "the function decides by a value which it does not have yet: it is called once with symbols, and recorded; "
    "expected saltus.where(condition, a, b) in place of 'if', 'and', 'or', 'not', min(), max() and the like"
)
_NUMBER = (
    "the function turns a symbol into a number: it is called once with symbols, and recorded; expected arithmetic, "
    "functions of math and numpy, and saltus.where (numpy.sin in place of math.sin in a static method)"
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
            raise TypeError(f"numpy.{ufunc.__name__} cannot be recorded; expected saltus.where, or one of {', '.join(sorted(_UFUNCS))}")
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

    def __round__(self) -> Any:
        return _floor(self + 0.5)

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
    """The result of a comparison, for saltus.where; conditions are joined by &, | and ^, among themselves and with True
    and False, compared by == and !=, and negated by ~. In arithmetic they are 1 or 0."""

    __slots__ = ()

    def __and__(self, other: Any) -> Any:
        return _join(self, other, lambda truth: self if truth else False, lambda: self._apply("and", self, other))

    def __or__(self, other: Any) -> Any:
        return _join(self, other, lambda truth: True if truth else self, lambda: self._apply("or", self, other))

    def __xor__(self, other: Any) -> Any:
        return _join(self, other, lambda truth: ~self if truth else self, lambda: (self & ~other) | (~self & other))

    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    def __invert__(self) -> Expression:
        return self._apply("not", self)

    def __eq__(self, other: Any) -> Any:
        return ~(self ^ other)

    def __ne__(self, other: Any) -> Any:
        return self ^ other


def _join(condition: Condition, other: Any, with_truth: Callable[[bool], Any], record: Callable[[], Any]) -> Any:
    """A condition with another one, or with a truth value that is known."""
    if isinstance(other, np.ndarray):
        return NotImplemented
    if isinstance(other, (bool, np.bool_)):
        return with_truth(bool(other))
    if not isinstance(other, Condition):
        raise TypeError(f"found a condition joined with {_kind(other)}, expected another condition, True or False")
    return record()


def _kind(value: Any) -> str:
    return "a number" if isinstance(value, Expression) else type(value).__name__


_CONDITIONS = ("less", "less_equal", "and", "or", "not", "larger")
_MOST_UNKNOWNS = 12  # of linear equations


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

    Conditions are comparisons, joined by ``&``, ``|`` and ``^``, negated by ``~``. Arrays and lists are chosen entry by
    entry. A condition on the state or the time makes a switch: the simulation locates where it changes. Of numbers it is
    numpy.where.
    """
    values = [_as_array(value) for value in (condition, a, b)]
    if not any(isinstance(entry, Expression) for value in values for entry in value.flat):
        return np.where(condition, a, b)

    def choose(test: Any, yes: Any, no: Any) -> Any:
        if not isinstance(test, Expression):
            return yes if test else no
        if not isinstance(test, Condition):
            raise TypeError("found a number as the condition of saltus.where, expected a comparison")
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


def _is_larger(a: Any, b: Any) -> Any:
    """Whether |a| > |b|, for choices that change no result: no switch is made of it."""
    for value in (a, b):
        if isinstance(value, Expression):
            return value._apply("larger", a, b)
    return abs(a) > abs(b)


def _either(condition: Any, a: Any, b: Any) -> Any:
    if not isinstance(condition, Expression):
        return a if condition else b
    return a if a is b else Expression._apply(condition, "where", condition, a, b)


_SINGULAR = 1e-30  # square of a pivot, of those of the numbers that it is a sum of: rounding


def _solve(a: Any, b: Any) -> Any:
    """numpy.linalg.solve by Gauss's elimination with pivots. Where the matrix is singular, the result is NaN."""
    matrix, right = _as_array(a), _as_array(b)
    if not any(isinstance(entry, Expression) for entry in (*matrix.flat, *right.flat)):
        return np.linalg.solve(a, b)
    n = len(matrix) if matrix.ndim == 2 else 0
    if n == 0 or matrix.shape != (n, n) or right.ndim not in (1, 2) or len(right) != n:
        raise ValueError(f"found a matrix of shape {matrix.shape} and a right-hand side of shape {right.shape}, "
                         "expected (n, n) and (n,) or (n, k)")
    if n > _MOST_UNKNOWNS:
        raise ValueError(f"found {n} unknowns, expected at most {_MOST_UNKNOWNS} in a function that is recorded")
    # Each row: that of the matrix, of the right-hand side, and squares of the sizes of the numbers that entries are sums of.
    rows = [[*matrix[i], *np.atleast_1d(right[i]), *(entry * entry for entry in matrix[i])] for i in range(n)]
    columns = len(rows[0]) - 2 * n
    sizes = n + columns
    for k in range(n):
        for i in range(k + 1, n):
            swaps = _is_larger(rows[i][k], rows[k][k])
            pairs = list(zip(rows[k], rows[i]))
            rows[k] = [_either(swaps, other, one) for one, other in pairs]
            rows[i] = [_either(swaps, one, other) for one, other in pairs]
        pivot = rows[k][k]
        regular = _is_larger(pivot * pivot, _SINGULAR * rows[k][sizes + k])
        if regular is False or regular is np.False_:
            raise ValueError("the matrix is singular, whatever the arguments are")
        rows[k][k] = _either(regular, pivot, math.nan)
        for i in range(k + 1, n):
            if not isinstance(rows[i][k], Expression) and rows[i][k] == 0:
                continue
            factor = rows[i][k] / rows[k][k]
            for j in range(k + 1, sizes):
                rows[i][j] = rows[i][j] - factor * rows[k][j]
            for j in range(sizes + k + 1, sizes + n):
                rows[i][j] = rows[i][j] + factor * factor * rows[k][j]
    result = np.empty((n, columns), dtype=object)
    for i in reversed(range(n)):
        for j in range(columns):
            rest = rows[i][n + j]
            for k in range(i + 1, n):
                rest = rest - rows[i][k] * result[k, j]
            result[i, j] = rest / rows[i][i]
    return result[:, 0] if right.ndim == 1 else result


def _select(conditions: Sequence[Any], choices: Sequence[Any], default: Any = 0) -> Any:
    for condition, choice in reversed(list(zip(conditions, choices))):
        default = where(condition, choice, default)
    return default


def _table(name: str, x: Any, xs: Any, ys: Any, piece: Callable[[Any, Any], Callable[[int, Any], Any]]) -> Any:
    """The values at x of a table, by the function of its intervals and of a number that `piece` returns for its points.
    Interval -1 is before the first point, and interval n - 1 behind the last one of n. Symbols have the points as switches.

    name: of the function, points and values, for messages."""
    name, *kinds = name.split()
    symbols, points, values = _as_array(x), _as_array(xs), _as_array(ys)
    for kind, numbers in zip(["x", *kinds], (symbols, points, values)):
        for entry in numbers.flat:
            if not isinstance(entry, (Expression, int, float, np.integer, np.floating)):
                raise TypeError(f"{name}: found {entry!r} in {kind}, expected numbers, or symbols of a function that is recorded, such as x[0]; "
                                f"call {name}({', '.join(['x', *kinds])}) in a flow, guard, reset or cost")
    for kind, numbers in zip(kinds, (points, values)):
        if not all(isinstance(entry, Expression) or math.isfinite(entry) for entry in numbers.flat):
            raise ValueError(f"{name}: found {kind} with a number that is not finite, expected finite numbers")
    known = not any(isinstance(entry, Expression) for entry in points.flat)
    if not known or points.ndim != 1 or points.shape != values.shape or len(points) == 0 or not np.all(np.diff(points) > 0):
        raise ValueError(f"{name}: expected {kinds[0]} with increasing numbers, and as many values {kinds[1]}")
    points = points.astype(float)
    of_piece = piece(points, values)

    def between(v: Any, low: int, high: int) -> Any:
        if low == high:
            return of_piece(low, v)
        middle = (low + high + 1) // 2
        return where(v < points[middle], between(v, low, middle - 1), between(v, middle, high))

    result = np.empty(symbols.shape, dtype=object)
    for i in np.ndindex(symbols.shape):
        v = symbols[i]
        known = not isinstance(v, Expression)
        if known and math.isnan(v):
            result[i] = v
            continue
        result[i] = of_piece(int(np.searchsorted(points, v, "right")) - 1, v) if known else between(v, -1, len(points) - 1)
    if not any(isinstance(entry, Expression) for entry in result.flat):
        result = result.astype(float)
    return result if result.ndim else result[()]


def interp(x: Any, xs: Any, ys: Any) -> Any:
    """The value at x of a table of values ys at increasing points xs, linear between them and constant outside.

    x: a number, a symbol of a function that is recorded, such as a state or the time, or an array of these. xs: numbers.
    ys: numbers or symbols, such as parameters. The points are switches of x: the simulation locates where it passes them.
    For numbers it equals numpy.interp.
    """
    return _table("interp xs ys", x, xs, ys, _linear)


def _linear(points: Any, values: Any) -> Callable[[int, Any], Any]:
    def at(i: int, v: Any) -> Any:
        if i < 0 or i == len(points) - 1:
            return values[max(i, 0)]
        return values[i] + (values[i + 1] - values[i]) / (points[i + 1] - points[i]) * (v - points[i])

    return at


def spline(x: Any, xs: Any, ys: Any) -> Any:
    """The value at x of the cubic spline through values ys at increasing points xs; arguments as of `interp`.

    It has two continuous derivatives, the third one is also continuous at the second and the last but one point
    (not-a-knot), and outside of the points it goes on with its first and last cubic. Through two points it is a line, and
    through three a parabola. The points are switches of x. For numbers it equals scipy.interpolate.CubicSpline(xs, ys)(x).
    """
    return _table("spline xs ys", x, xs, ys, _cubic)


def _cubic(points: Any, values: Any) -> Callable[[int, Any], Any]:
    n, h = len(points), np.diff(points).tolist()
    if n < 2:
        raise ValueError("spline: found one point in xs, expected at least two")
    rises = [(values[i + 1] - values[i]) / h[i] for i in range(n - 1)]
    slopes = _slopes_of_spline(h, rises) if n > 3 else [rises[0]] * 2 if n == 2 else _slopes_of_parabola(h, rises)

    def at(i: int, v: Any) -> Any:
        i = min(max(i, 0), n - 2)
        s, bend = v - points[i], (slopes[i] + slopes[i + 1] - 2 * rises[i]) / h[i]
        return values[i] + s * (slopes[i] + s * ((rises[i] - slopes[i]) / h[i] - bend + s * (bend / h[i])))

    return at


def _slopes_of_parabola(h: list[float], rises: list[Any]) -> list[Any]:
    bend = (rises[1] - rises[0]) / (h[0] + h[1])
    return [rises[0] - h[0] * bend, rises[0] + h[0] * bend, rises[1] + h[1] * bend]


def _slopes_of_spline(h: list[float], rises: list[Any]) -> list[Any]:
    """The slopes at the points of a spline that is not-a-knot, by elimination in its tridiagonal equations."""
    ends = []
    for (h0, h1), (r0, r1) in ((h[:2], rises[:2]), ((h[-1], h[-2]), (rises[-1], rises[-2]))):
        ends.append((h1, h0 + h1, ((3 * h0 + 2 * h1) * h1 * r0 + h0 * h0 * r1) / (h0 + h1)))
    diagonal, above, right = [ends[0][0]], [ends[0][1]], [ends[0][2]]
    below = [*h[1:], ends[1][1]]
    for i in range(1, len(h) + 1):
        inner = i < len(h)
        factor = below[i - 1] / diagonal[-1]
        diagonal.append((2 * (h[i - 1] + h[i]) if inner else ends[1][0]) - factor * above[-1])
        right.append((3 * (h[i] * rises[i - 1] + h[i - 1] * rises[i]) if inner else ends[1][2]) - factor * right[-1])
        above.append(h[i - 1])
    slopes = [right[-1] / diagonal[-1]]
    for i in reversed(range(len(h))):
        slopes.insert(0, (right[i] - above[i] * slopes[0]) / diagonal[i])
    return slopes


def _interp(x: Any, xp: Any, fp: Any, *arguments: Any, **keywords: Any) -> Any:
    """numpy.interp in functions that are recorded."""
    if not any(isinstance(entry, Expression) for of in (x, xp, fp) for entry in _as_array(of).flat):
        return np.interp(x, xp, fp, *arguments, **keywords)
    if arguments or keywords:
        raise TypeError(
            "numpy.interp is recorded with x, xp and fp alone. For left and right, write "
            "saltus.where(x < xp[0], left, saltus.where(x > xp[-1], right, np.interp(x, xp, fp))); for a period, let xp cover it and pass "
            "x % period"
        )
    return _table("numpy.interp xp fp", x, xp, fp, _linear)


def _inverse(a: Any) -> Any:
    return _solve(a, np.eye(len(a)))


def _norm(x: Any, *arguments: Any, **keywords: Any) -> Any:
    array = _as_array(x)
    if not any(isinstance(entry, Expression) for entry in array.flat):
        return np.linalg.norm(x, *arguments, **keywords)
    if arguments or keywords:
        raise TypeError("numpy.linalg.norm is recorded without further arguments, as the root of the sum of all squares")
    return _hypot(*array.flat)


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
    "rint": round,
    "trunc": lambda a: where(a >= 0, _floor(a), -_floor(-a)),
    "fmod": lambda a, b: a - b * where(a / b >= 0, _floor(a / b), -_floor(-(a / b))),
    "degrees": lambda a: a * (180 / math.pi),
    "radians": lambda a: a * (math.pi / 180),
    "cbrt": _cbrt,
    "heaviside": lambda a, at_zero: where(a > 0, 1.0, where(a < 0, 0.0, at_zero)),
    "exp2": lambda a: 2.0**a,
}
# What stands in the place of the functions of math in functions that are recorded.
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
    "logical_xor": lambda a, b: a ^ b,
    "equal": lambda a, b: a == b,
    "not_equal": lambda a, b: a != b,
    "bitwise_and": lambda a, b: a & b,
    "bitwise_or": lambda a, b: a | b,
    "bitwise_xor": lambda a, b: a ^ b,
    "invert": lambda a: ~a,
}
# Of arrays of objects numpy calls methods of these names.
for _name, _function in _UFUNCS.items():
    if not hasattr(Expression, _name):
        setattr(Expression, _name, (lambda f: lambda self, *rest: f(self, *rest))(_function))

# By the identity of a function of math or numpy: what records it.
_OF_MATH = {
    **{id(getattr(math, name)): replacement for name, replacement in _MATH.items()},
    id(np.linalg.solve): _solve,
    id(np.linalg.inv): _inverse,
    id(np.linalg.norm): _norm,
    id(np.select): _select,
    id(np.interp): _interp,
    id(np.where): lambda condition, *values: where(condition, *values) if values else np.where(condition),
}
_WITH_SUCH = (math, np, np.linalg)  # modules
_NOT_OF_USERS = sys.stdlib_module_names | {"numpy", "saltus"}


def _is_users(module: Any) -> bool:
    """Returns whether a module of this name may be a user's."""
    return isinstance(module, str) and module.partition(".")[0] not in _NOT_OF_USERS


class _Recording:
    """Gives a function, and what it calls, functions of math that take symbols, while math stays as it is.

    A function of the user's is copied with other values for the names that it reads: its globals, its closure and its
    defaults. Methods, modules and objects of the user's that it reads are replaced likewise, also in lists, tuples and
    dicts, but not what it reads of a class. Several threads may record at the same time, as none of this is seen by
    others.
    """

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, Any]] = {}  # by identity: the original, which thus stays alive, and what replaces it
        self._globals: dict[int, tuple[Any, Any, Any]] = {}  # by identity: the original, its copy, and the copy as it was made

    def replace(self, value: Any) -> Any:
        """Returns what stands for a value in functions that are recorded: mostly the value itself."""
        if id(value) in _OF_MATH:
            return _OF_MATH[id(value)]
        if id(value) in self._known:
            return self._known[id(value)][1]
        if isinstance(value, types.FunctionType) and _is_users(value.__module__):
            return self._function(value)
        if isinstance(value, types.MethodType) and isinstance(value.__func__, types.FunctionType):
            return types.MethodType(self.replace(value.__func__), self.replace(value.__self__))
        if type(value) is functools.partial:
            keywords = {name: self.replace(given) for name, given in value.keywords.items()}
            return functools.partial(self.replace(value.func), *map(self.replace, value.args), **keywords)
        if isinstance(value, types.ModuleType) and (value in _WITH_SUCH or _is_users(value.__name__)):
            return self._keep(value, _Module(self, value))
        if type(value) in (list, tuple) and any(map(_may_change, value)):
            return self._keep(value, type(value)(map(self.replace, value)))
        if type(value) is dict and any(map(_may_change, value.values())):
            return self._keep(value, {key: self.replace(held) for key, held in value.items()})
        return self._object(value) if _has_methods(type(value)) else value

    def finish(self) -> None:
        """Gives global variables that a function has assigned to their modules."""
        for original, names, made in self._globals.values():
            original.update({name: value for name, value in names.items() if value is not made.get(name, names)})

    def _keep(self, original: Any, replacement: Any) -> Any:
        self._known[id(original)] = (original, replacement)
        self._known[id(replacement)] = (replacement, replacement)
        return replacement

    def _function(self, function: types.FunctionType) -> Any:
        cells = function.__closure__ or ()
        # A cell whose value stays as it is remains the same one, which the function may assign to.
        closure = tuple(types.CellType() if _may_change(_content(cell)) else cell for cell in cells)
        names = self._names(function.__globals__)
        copied = types.FunctionType(function.__code__, names, function.__name__, closure=closure)
        copied.__qualname__, copied.__module__ = function.__qualname__, function.__module__
        self._keep(function, copied)
        for cell, original in zip(closure, cells):
            if cell is not original:
                cell.cell_contents = self.replace(_content(original))
        copied.__defaults__ = function.__defaults__ and tuple(map(self.replace, function.__defaults__))
        copied.__kwdefaults__ = function.__kwdefaults__ and {
            name: self.replace(value) for name, value in function.__kwdefaults__.items()
        }
        made = self._globals[id(function.__globals__)][2]
        for name in _names_in(function.__code__):
            if name in names and names[name] is made[name]:
                names[name] = made[name] = self.replace(names[name])
        return copied

    def _names(self, names: dict[str, Any]) -> dict[str, Any]:
        if id(names) not in self._globals:
            copied = {**names, "__builtins__": {**vars(builtins), "__import__": self._import}}
            self._globals[id(names)] = (names, copied, dict(copied))
        return self._globals[id(names)][1]

    def _import(self, *arguments: Any, **keywords: Any) -> Any:
        return self.replace(builtins.__import__(*arguments, **keywords))

    def _object(self, value: Any) -> Any:
        """An object with the attributes of `value`, of a class derived from its class, whose methods are replaced."""
        replace, kind = self.replace, type(value)

        def attribute(shadow: Any, name: str) -> Any:
            return replace(kind.__getattribute__(shadow, name))

        own = {"__getattribute__": attribute}
        if isinstance(getattr(kind, "__call__", None), types.FunctionType):
            own["__call__"] = replace(kind.__call__)
        try:
            shadow = object.__new__(type(kind)(kind.__name__, (kind,), own))
            object.__setattr__(shadow, "__dict__", value.__dict__)
        except (AttributeError, TypeError):  # its numbers are not in a dict
            return value
        return self._keep(value, shadow)


class _Module:
    """A module as functions that are recorded see it."""

    def __init__(self, recording: _Recording, module: types.ModuleType):
        self._recording, self._module = recording, module

    def __getattr__(self, name: str) -> Any:
        return self._recording.replace(getattr(self._module, name))


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not assigned to yet
        return None


def _has_methods(kind: type) -> bool:
    """Returns whether objects of a class are a user's and have methods of their own."""
    if type(kind) not in (type, abc.ABCMeta) or not _is_users(kind.__module__):
        return False
    members = [item for base in kind.__mro__ if _is_users(base.__module__) for item in vars(base).items()]
    return all(name not in ("__init_subclass__", "__slots__") for name, _ in members) and any(
        isinstance(member, types.FunctionType) and (not name.startswith("__") or name == "__call__")
        for name, member in members
    )


def _may_change(value: Any) -> bool:
    kinds = (types.FunctionType, types.MethodType, types.ModuleType, functools.partial)
    if type(value) in (list, tuple, dict):
        return any(map(_may_change, value.values() if isinstance(value, dict) else value))
    return isinstance(value, kinds) or id(value) in _OF_MATH or _has_methods(type(value))


def _names_in(code: types.CodeType) -> set[str]:
    """Returns the names that a function and the functions within it read or assign to."""
    names = set(code.co_names)
    return names.union(*(_names_in(inner) for inner in code.co_consts if isinstance(inner, types.CodeType)))


def call(function: Any, *arguments: Any, **keywords: Any) -> Any:
    """What the function returns for symbols."""
    recording = _Recording()
    try:
        return recording.replace(function)(*arguments, **keywords)
    finally:
        recording.finish()


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
