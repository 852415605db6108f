"""Hybrid systems of a user's own: flow, guards and resets as ordinary functions."""

from __future__ import annotations

import copy
import functools
import itertools
import json
import os
import warnings
from typing import Any, Callable, Iterable, Mapping, Sequence, overload

import numpy as np
from numpy.typing import ArrayLike

from . import _saltus
from ._expression import Condition, Tape, _as_array, call, outputs
from ._progress import CountedProgress
from ._results import KINDS, Result, WrongGradient, on_intervals
from ._scene import Scene, SceneLike, as_scene
from ._types import Closed, _is_number, asked_for, expect, expect_int, parameters_of

# The arguments of terms, in the order of the blocks of C++; there x0 is "i", and xT is "x".
_READS = "xiupth"
_LETTERS = {"x": "x", "xT": "x", "x0": "i", "u": "u", "p": "p", "t": "t", "h": "h"}


def _named(kind: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise TypeError(f"{kind}: found {type(value).__name__}, expected a dict")
    return dict(value)


def _names(kind: str, value: Any) -> list[str]:
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{kind}: found {type(value).__name__}, expected a list of names")
    names = list(value)
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"{kind}: found {name!r}, expected a name")
    if len(set(names)) < len(names):
        raise ValueError(f"{kind}: found {next(n for n in names if names.count(n) > 1)!r} twice")
    return names


def _at(what: str, error: Exception) -> Exception:
    """The error with its place. Classes of libraries may take other arguments than a text."""
    for kind in (TypeError, ValueError):
        if isinstance(error, kind):
            return kind(f"{what}: {error}")
    return RuntimeError(f"{what}: {type(error).__name__}: {error}")


def _call(what: str, function: Any, known: Mapping[str, Any], order: Sequence[str],
          refused: Mapping[str, str] | None = None) -> Any:
    """What the function returns for symbols, which it is given by the names of its arguments; what it raises is raised
    again with its place."""
    if not callable(function):
        raise TypeError(f"{what}: found {type(function).__name__}, expected a function")
    try:
        positional, keywords = asked_for(function, known, order, refused)
        return call(function, *positional, **keywords)
    except Exception as error:
        raise _at(what, error) from error


def _outputs(what: str, tape: Tape, values: Any, expected: int | None = None) -> Any:
    try:
        return outputs(tape, values, expected)
    except (TypeError, ValueError) as error:
        raise _at(what, error) from error


class System(Closed):
    """What problems ask of a system, whatever its kind: of its modes by name, of which those of a mechanical system are
    created as a motion meets them."""

    controls: list[str]
    parameters: list[str]
    draw: Any = None
    _system: Any
    _ranges: Mapping[str, tuple[float, float]] = {}  # of parameters that have a range by what they are
    _longest: float = np.inf  # the longest motion for which its functions are given

    def _make(self) -> Any:
        """Returns the system of C++."""
        raise NotImplementedError

    def _mode_number(self, mode: str | None) -> int:
        """Returns the number of a mode, -1 for the one that the state at the start has. Raises ValueError."""
        raise NotImplementedError

    def _states_of(self, mode: str | None) -> list[str]:
        raise NotImplementedError

    def _symbols(self, mode: str, control: bool) -> tuple[Tape, dict[str, Any]]:
        """Symbols for t, x, u and p; the inputs of a record are [x t p u]."""
        tape, n, parameters = Tape(), len(self._states_of(mode)), len(self.parameters)
        symbols = {"x": tape.inputs(0, n), "t": tape.inputs(n, 1)[0], "p": tape.inputs(n + 1, parameters)}
        if control:
            symbols["u"] = tape.inputs(n + 1 + parameters, len(self.controls))
        return tape, symbols

    def _guards_of(self, mode: str) -> list[str]:
        raise NotImplementedError

    def _all_guards(self) -> list[str]:
        """Returns the names of the guards of all modes."""
        raise NotImplementedError

    def _size_after(self, mode: str, guard: str) -> int:
        """Returns the size of the state after an event."""
        raise NotImplementedError

    def _state_sizes(self) -> set[int]:
        """Returns the sizes of the states of all modes."""
        raise NotImplementedError

    def _modes_after(self, mode: str, guard: str, parameters: Any) -> list[str]:
        """Returns the modes to which an event may lead, the likeliest first."""
        raise NotImplementedError

    def _find_sequence(self, mode: str, events: Sequence[Any], parameters: Any) -> list[tuple[str, str]] | None:
        """Returns the modes and guards of events by their names from a mode on, and at last the mode at the end."""
        if not events:
            return [(mode, "")]
        guard, wanted = (events[0], None) if isinstance(events[0], str) else events[0]
        if guard not in self._guards_of(mode):
            return None
        for after in self._modes_after(mode, guard, parameters):
            if wanted in (None, after):
                rest = self._find_sequence(after, events[1:], parameters)
                if rest is not None:
                    return [(mode, guard), *rest]
        return None

    def _drawn(self, mode: str, t: float, x: Any) -> dict[str, Any]:
        """The values by whose names a drawing may ask for them."""
        return {"mode": mode, "t": t, "x": x}

    def _frame(self, draw: Any, mode: str, t: float, x: Any, p: Any) -> dict[str, Any]:
        """Lines and circles of a state, from what the user's function returns."""
        known = {**self._drawn(mode, t, x), "p": p}
        frame: dict[str, Any] = {"lines": [], "circles": []}
        try:
            positional, keywords = asked_for(draw, known, "txp")
            for shape in draw(*positional, **keywords):
                numbers = [float(number) for number in np.ravel(shape)]
                if len(numbers) not in (3, 4):
                    raise ValueError(f"found {len(numbers)} numbers, expected [x0, y0, x1, y1] of a line or [x, y, r] of a circle")
                frame["circles" if len(numbers) == 3 else "lines"].append(numbers)
        except Exception as error:
            raise _at("draw", error) from error
        return frame

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_system", "draw")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._system = self._make()


class HybridSystem(System):
    """A hybrid system: a state that flows smoothly until a guard falls through zero, and is then reset.

    states: the modes, each with the names of its states. controls, parameters: names. SI units, or any others.
    flow: of each mode a function of some of t, x, u and p that returns the derivatives of the states.
    guards: of each mode that has any, functions of some of t, x, u and p by the name of the guard; an event happens where
    one falls through zero, or where a jump of the control takes it below.
    resets: of each guard a function of some of t, x and p that returns the next mode and its state.
    on_accumulation: of any guard the mode in which a motion goes on where its events accumulate (Zeno behaviour): their
    times converge, or they repeat without time passing.
    fly: of any mode a closed form of its flow, a function of some of t, s, x, u and p that returns the state at t + s of
    the state x at t; it takes the place of the integration. Steps must be so short that no guard crosses zero twice in one.
    sliding: "filippov": a motion that both sides of a condition drive towards its zero goes on along it, with the average of
    both flows that keeps it there, until one side leads away. Without it such a motion ends with the reason.

    draw: for pages (``save_page``), a function of some of mode, t, x and p that returns a list of lines [x0, y0, x1, y1] and
    circles [x, y, radius]. It is called with numbers; a pickle has none.

    The names of a function's arguments decide what it gets, in any order. A function with other names gets the arguments in
    the order (t, x, u, p), (t, x, p) or (t, s, x, u, p); a name that would stand in the place of another is refused.

        >>> ball = saltus.HybridSystem(
        ...     states={"flight": ["y", "v"]}, controls=["f"], parameters=["g", "e"],
        ...     flow={"flight": lambda t, x, u, p: [x[1], -p[0] + u[0]]},
        ...     guards={"flight": {"ground": lambda t, x, p: x[0]}},
        ...     resets={"flight": {"ground": lambda t, x, p: ("flight", [x[0], -p[1] * x[1]])}})

    The functions are called once, here, with symbols, and recorded: arithmetic, powers, the functions of math and numpy
    and saltus.where. C++ evaluates and differentiates the record; no Python runs then. x, u and p are arrays.

    Raises TypeError where a function branches on a value, ValueError where sizes or names do not match, RuntimeError for
    what a function raises; each names the mode and the guard.
    """

    _attributes = ("modes", "states", "controls", "parameters", "guards", "sliding", "draw")

    def __init__(
        self,
        *,
        states: Mapping[str, Sequence[str]],
        flow: Mapping[str, Callable[..., Any]],
        guards: Mapping[str, Mapping[str, Callable[..., Any]]] | None = None,
        resets: Mapping[str, Mapping[str, Callable[..., Any]]] | None = None,
        controls: Sequence[str] = (),
        parameters: Sequence[str] = (),
        on_accumulation: Mapping[str, Mapping[str, str]] | None = None,
        fly: Mapping[str, Callable[..., Any]] | None = None,
        sliding: str | None = None,
        draw: Callable[..., Any] | None = None,
    ):
        expect("a callable", draw=draw)
        self.draw = draw
        if sliding not in (None, "filippov"):
            raise ValueError(f"sliding: found {sliding!r}, expected 'filippov' or None")
        self.sliding = sliding
        self.modes = _names("states", _named("states", states))
        self.states = {mode: _names(f"states of mode '{mode}'", states[mode]) for mode in self.modes}
        self.controls = _names("controls", controls)
        self.parameters = _names("parameters", parameters)
        if not self.modes:
            raise ValueError("states: found no mode, expected at least one")
        given: list[tuple[str, dict[str, Any]]] = [
            ("flow", _named("flow", flow)),
            ("guards", _named("guards", guards or {})),
            ("resets", _named("resets", resets or {})),
            ("on_accumulation", _named("on_accumulation", on_accumulation or {})),
            ("fly", _named("fly", fly or {})),
        ]
        for kind, by_mode in given:
            for mode in by_mode:
                if mode not in self.states:
                    raise ValueError(f"{kind}: found mode {mode!r}, expected some of {', '.join(self.modes)}")
        self.guards: dict[str, list[str]] = {}
        self._next_modes: dict[tuple[str, str], str] = {}
        recorded = []
        for mode in self.modes:
            if not self.states[mode]:
                raise ValueError(f"states of mode '{mode}': found none, expected at least one")
            if mode not in given[0][1]:
                raise ValueError(f"flow: found none of mode '{mode}'")
            of_guards = _named(f"guards of mode '{mode}'", given[1][1].get(mode, {}))
            of_resets = _named(f"resets of mode '{mode}'", given[2][1].get(mode, {}))
            if set(of_guards) != set(of_resets):
                odd = sorted(set(of_guards) ^ set(of_resets))[0]
                raise ValueError(f"mode '{mode}': found '{odd}' only in one of guards and resets, expected it in both")
            self.guards[mode] = list(of_guards)
            goes_on = self._modes_after_accumulation(mode, given[3][1].get(mode, {}))
            transitions = [
                (name, *self._record_guard(mode, name, guard, of_resets[name]), goes_on.get(name, -1))
                for name, guard in of_guards.items()
            ]
            closed_form = self._record_fly(mode, given[4][1][mode]) if mode in given[4][1] else None
            of_flow = self._record_flow(mode, given[0][1][mode])
            recorded.append((mode, self.states[mode], of_flow, transitions, closed_form))
        self._record = recorded
        self._system = self._make()

    def _make(self) -> Any:
        return _saltus.HybridSystem(self._record, self.controls, self.parameters, self.sliding is not None)

    def _mode_number(self, mode: str | None) -> int:
        if not isinstance(mode, str) or mode not in self.states:
            raise ValueError(f"mode: found {mode!r}, expected some of {', '.join(self.modes)}")
        return self.modes.index(mode)

    def _states_of(self, mode: str | None) -> list[str]:
        return self.states[str(mode)]

    def _guards_of(self, mode: str) -> list[str]:
        return self.guards[mode]

    def _all_guards(self) -> list[str]:
        return list(dict.fromkeys(guard for guards in self.guards.values() for guard in guards))

    def _size_after(self, mode: str, guard: str) -> int:
        return len(self.states[self._next_modes[mode, guard]])

    def _state_sizes(self) -> set[int]:
        return set(map(len, self.states.values()))

    def _modes_after(self, mode: str, guard: str, parameters: Any) -> list[str]:
        return [self._next_modes[mode, guard]]

    def _modes_after_accumulation(self, mode: str, named: Any) -> dict[str, int]:
        what = f"on_accumulation of mode '{mode}'"
        for guard, after in _named(what, named).items():
            if guard not in self.guards[mode]:
                raise ValueError(f"{what}: found guard {guard!r}, expected some of {', '.join(self.guards[mode])}")
            if after not in self.states or len(self.states[after]) != len(self.states[mode]):
                raise ValueError(f"{what}: found mode {after!r}, expected one with {len(self.states[mode])} states")
        return {guard: self.modes.index(after) for guard, after in named.items()}

    def _record_flow(self, mode: str, function: Any) -> Any:
        tape, symbols = self._symbols(mode, control=True)
        what = f"flow of mode '{mode}'"
        return _outputs(what, tape, _call(what, function, symbols, "txup"), len(self.states[mode]))

    def _record_fly(self, mode: str, function: Any) -> Any:
        tape, symbols = self._symbols(mode, control=True)
        symbols["s"] = tape.inputs(len(self.states[mode]) + 1 + len(self.parameters) + len(self.controls), 1)[0]
        what = f"fly of mode '{mode}'"
        return _outputs(what, tape, _call(what, function, symbols, "tsxup"), len(self.states[mode]))

    def _record_guard(self, mode: str, name: str, guard: Any, reset: Any) -> tuple[Any, Any, int]:
        no_control = {"u": "resets read t, x and p; make the control a state, whose rate the control is"}
        reads_control = callable(guard) and "u" in (parameters_of(guard) or {})
        tape, symbols = self._symbols(mode, reads_control)
        what = f"guard '{name}' of mode '{mode}'"
        value = _call(what, guard, symbols, "txup" if reads_control else "txp")
        if any(isinstance(entry, (Condition, bool, np.bool_)) for entry in np.ravel(_as_array(value))):
            raise TypeError(f"{what}: found a condition; a guard is a number that falls through zero (x - 1 for x < 1)")
        of_guard = _outputs(what, tape, value, 1)
        tape, symbols = self._symbols(mode, control=False)
        what = f"reset '{name}' of mode '{mode}'"
        result = _call(what, reset, symbols, "txp", no_control)
        if not isinstance(result, tuple) or len(result) != 2 or not isinstance(result[0], str):
            raise ValueError(f"{what}: found {result!r}, expected the next mode's name and its state")
        if result[0] not in self.states:
            raise ValueError(f"{what}: found mode '{result[0]}', expected some of {', '.join(self.modes)}")
        of_reset = _outputs(what, tape, result[1], len(self.states[result[0]]))
        self._next_modes[mode, name] = result[0]
        return of_guard, of_reset, self.modes.index(result[0])

    def __repr__(self) -> str:
        modes = ", ".join(f"{mode} ({len(states)})" for mode, states in self.states.items())
        return f"<saltus.HybridSystem of modes {modes}; controls {self.controls}, parameters {self.parameters}>"


class Record:
    """What was recorded of the function of a cost, which can be pickled."""

    def __init__(self, of_cost: Any):
        self.of_cost = of_cost

    def __call__(self, *arguments: Any) -> Any:
        raise TypeError("the function of a cost that was pickled is not kept; its record is evaluated in its problem only")


class Cost(Closed):
    """A term of a problem: residuals whose squares are summed (a cost), or that are to be 0 or at most 0."""

    _attributes = ("name", "function", "at", "role", "mode", "guard", "before", "size")

    def __init__(self, name: str, function: Callable[..., Any], at: str | Sequence[float], role: str, mode: str | None,
                 guard: str | None, before: bool, size: int | None):
        self.name, self.function, self.at, self.role = name, function, at, role
        self.mode, self.guard, self.before = mode, guard, before
        self.size = size  # of the state, where the function implies it

    def __repr__(self) -> str:
        where = self.at if isinstance(self.at, str) else f"{len(self.at)} times"
        where = f"{where} of guard '{self.guard}'" if self.guard else where
        return f"<saltus cost '{self.name}', {self.role} at {where}>"

    @property
    def _times(self) -> tuple[float, ...]:
        """The times at which it counts, if these are given."""
        return () if isinstance(self.at, str) else tuple(self.at)

    def _terms(self, problem: HybridProblem) -> list[Any]:
        """The terms of C++: one, or one for each time."""
        recorded = self._recorded(problem)
        if not self._times:
            return [recorded]
        return [_at_node(recorded, node, problem.intervals) for node in problem._nodes_of(self)]

    def _data(self) -> list[tuple[str, float, float, float, bool]] | None:
        """What was measured, for each residual of its terms: quantity, time, value, sigma, and whether this is stated; None of
        a cost that is no data."""
        return None

    def _as_recorded(self, problem: HybridProblem) -> Cost:
        """The same cost with its record in place of its function."""
        record = Record(self._recorded(problem))
        return Cost(self.name, record, self.at, self.role, self.mode, self.guard, self.before, self.size)

    def _recorded(self, problem: HybridProblem) -> Any:
        system = problem.system
        if isinstance(self.function, Record):
            reads, sizes = self.function.of_cost[7:9]
            if "x" in reads:
                self._check_size(system, sizes[reads.index("x")])
            return _in_mode(self.function.of_cost, self._mode_in(system))
        parameters = parameters_of(self.function)
        if parameters is None:
            raise ValueError(f"{self.name}: found a function without a signature, expected a def or a lambda")
        names = []
        for name, parameter in parameters.items():
            if parameter.default is not parameter.empty:
                continue
            if name not in _LETTERS or parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                raise ValueError(f"{self.name}: found an argument {name!r}, expected some of t, x, u, p, h, x0 and xT")
            names.append(name)
        at = self.at if isinstance(self.at, str) else "steps"
        if "h" in names and self.at == "always":
            raise ValueError(f"{self.name}: found an argument 'h', the length of an interval, of a term at=\"always\", which holds at each "
                             "time within the intervals; expected some of t, x, u and p. Take at=\"steps\" for a term with h, of which "
                             "each interval has one value")
        wrong = [name for name in names if name in ("u", "h") and self.at not in ("steps", "always")]
        if wrong:
            where = f"at={self.at!r}".replace("'", '"') if isinstance(self.at, str) else "at given times"
            raise ValueError(f"{self.name}: found an argument {wrong[0]!r} of a term {where}, expected some of t, x and p. Only a term "
                             "at=\"steps\" reads the control u and the length h of an interval")
        if self.at != "end" and ("x0" in names or "xT" in names):
            raise ValueError(f"{self.name}: only a term at the end reads the states x0 at the start and xT at the end")
        letters = {_LETTERS[name] for name in names}
        if at == "always" and not letters & {"x", "t"}:
            at = "steps"  # it has one value in each control interval
        elif at == "always":
            letters = {"x", "t", "h", *("u" if system.controls else ""), *("p" if system.parameters else "")}
        mode = self._mode_in(system)
        sizes = {"x": self._state_size(system) if "x" in letters else 0, "i": len(system._states_of(problem.mode)),
                 "u": len(system.controls), "p": len(system.parameters), "t": 1, "h": 1}
        tape, first = Tape(), 0
        symbols = {_LETTERS[name]: () for name in names}  # the controls and parameters of a system that has none
        reads = [letter for letter in _READS if letter in letters and sizes[letter] > 0]
        for name in reads:
            inputs = tape.inputs(first, sizes[name])
            symbols[name] = inputs[0] if name in "th" else inputs
            first += sizes[name]
        values = _call(self.name, self.function, {name: symbols[_LETTERS[name]] for name in names}, "")
        found = _outputs(self.name, tape, values)
        return (self.name, at, self.role, mode, self.guard or "", self.before, -1, "".join(reads), [sizes[r] for r in reads], found)

    def _check_size(self, system: System, size: int) -> None:
        if size not in system._state_sizes():
            raise ValueError(f"{self.name}: found a state of {size} numbers, which no mode has")

    def _mode_in(self, system: System) -> int:
        """Returns the number of its mode, -1 without one. Raises ValueError if the system has no such mode or guard."""
        try:
            number = -1 if self.mode is None else system._mode_number(self.mode)
        except ValueError as error:
            raise _at(self.name, error) from error
        guards = [] if self.guard is None else system._all_guards() if self.mode is None else system._guards_of(self.mode)
        if self.guard is not None and self.guard not in guards:
            of = "" if self.mode is None else f" of mode '{self.mode}'"
            raise ValueError(f"{self.name}: found guard {self.guard!r}{of}, expected some of {', '.join(guards)}")
        return number

    def _state_size(self, system: System) -> int:
        if self.size is not None:
            self._check_size(system, self.size)
            return self.size
        if self.guard is not None and self.mode is not None and not self.before:
            return system._size_after(str(self.mode), self.guard)
        if self.mode is not None:
            return len(system._states_of(self.mode))
        sizes = system._state_sizes()
        if len(sizes) > 1:
            raise ValueError(f"{self.name}: found no mode, expected one, as modes have states of different sizes")
        return sizes.pop()


def _in_mode(recorded: Any, mode: int) -> Any:
    """A term of C++ with its mode in the system at hand: a mechanical system numbers its modes as it meets them."""
    return (*recorded[:3], mode, *recorded[4:])


def _at_node(recorded: Any, node: int, intervals: int) -> Any:
    """A term of C++ at the beginning of an interval, or at the end of the motion."""
    name, _, *rest = recorded
    role, mode, guard, before, _, *function = rest
    if node == intervals:
        return (name, "end", role, mode, guard, before, -1, *function)
    return (name, "steps", role, mode, guard, before, node, *function)


def _read_times(name: str, times: Any) -> tuple[float, ...]:
    try:
        found = np.asarray(times, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: found {times!r}, expected a list of times") from None
    if found.ndim != 1 or found.size == 0 or not np.all(np.isfinite(found)) or np.any(found < 0):
        raise ValueError(f"{name}: found {times!r}, expected a list of finite times of at least 0")
    return tuple(found.tolist())


def residuals(
    function: Callable[..., Any],
    *,
    at: str | Sequence[float] = "end",
    mode: str | None = None,
    guard: str | None = None,
    before: bool = False,
    role: str = "cost",
    name: str | None = None,
) -> Cost:
    """A term of a problem from a function of some of t, x, u, p and h, by the names of its arguments.

    at: "steps", the beginnings of the control intervals, of length h; "event", every event of `guard`, in any mode or in
    `mode`, with the state after it, or before it if `before`; "end", after events there; or a list of times, which are those of
    beginnings of control intervals or of the end (``durations=`` puts these anywhere). A function at the end may also read
    the state at the start as x0 and that at the end as xT: ``lambda x0, xT: xT - x0`` is zero for a periodic motion. mode:
    where it counts; any without.
    "always" is for inequalities that hold at all times, between the beginnings of intervals too: in each interval each residual is
    taken at the end, and where it is greatest before that, along the flow of the mode. This is integrated in eight parts, or as
    many as the motion has steps there, and each is searched for a time at which the rate of the residual falls through zero. A
    residual that rises and falls twice within a part may exceed its bound there. Solvers in phases put the ends of intervals at
    events.
    role: "cost": the loss gains the sum of the squares; "equality": the residuals are to be 0; "inequality": at most 0.
    """
    if not isinstance(at, str):
        at = _read_times("at", at)
    elif at not in ("steps", "always", "event", "end"):
        raise ValueError(f"at: found {at!r}, expected one of steps, always, event, end, or a list of times")
    if role not in ("cost", "equality", "inequality"):
        raise ValueError(f"role: found {role!r}, expected one of cost, equality, inequality")
    if at == "always" and role != "inequality":
        raise ValueError(f"at: found 'always' with the role {role!r}, expected 'inequality'; a cost over time is one at steps, whose "
                         "function multiplies by the length h of the interval")
    if not callable(function):
        raise TypeError(f"function: found {type(function).__name__}, expected a function")
    if at == "event" and guard is None:
        raise ValueError("at: found an event without a guard, expected guard= with its name")
    if at != "event" and (guard is not None or before):
        raise ValueError("guard: only a term at events has one")
    place = at if isinstance(at, str) else "given times"
    label = name or getattr(function, "__name__", "cost").replace("<lambda>", f"cost at {place}")
    return Cost(label, function, at, role, mode, guard, before, None)


def cost(
    function: Callable[..., Any],
    *,
    at: str | Sequence[float] = "end",
    mode: str | None = None,
    guard: str | None = None,
    before: bool = False,
    name: str | None = None,
) -> Cost:
    """A cost that is no square: the loss gains the value of a function, of some of t, x, u, p and h.

    The function returns a number, or several that are summed; the other arguments are those of `residuals`. A Mayer cost
    is ``saltus.cost(lambda x: x[2])``; the integral of f over time is
    ``saltus.cost(lambda x, u, h: h * f(x, u), at="steps")`` by the rule of rectangles.
    """
    term = residuals(function, at=at, mode=mode, guard=guard, before=before, name=name)
    term.role = "value"
    return term


def maximise(function: Callable[..., Any], **options: Any) -> Cost:
    """The negative of `cost`, with the same arguments: the loss loses the value of a function."""

    @functools.wraps(function)
    def negative(*arguments: Any, **named: Any) -> Any:
        values = function(*arguments, **named)
        return [-value for value in values] if np.ndim(values) > 0 else -values

    return cost(negative, **options)


def _refuse_bools(name: str, values: Any) -> None:
    """Raises TypeError if numbers have a bool among them, which numpy takes for 0 or 1."""
    if isinstance(values, np.ndarray) and values.dtype.kind not in "bO":
        return
    if any(isinstance(value, (bool, np.bool_)) for value in np.ravel(np.asarray(values, dtype=object))):
        raise TypeError(f"{name}: found bool, expected real numbers")


def _listed_costs(costs: Any) -> list[Any]:
    """The costs of a problem as a list. Raises TypeError."""
    expected = "expected a list of saltus.terminal, saltus.effort, ... and functions"
    if isinstance(costs, (str, Mapping)) or not isinstance(costs, Iterable):
        raise TypeError(f"costs: found {type(costs).__name__}, {expected}")
    listed = list(costs)
    for i, one in enumerate(listed):
        if not isinstance(one, Cost) and not callable(one):
            raise TypeError(f"costs[{i}]: found {one!r}, {expected}")
    return listed


def _components(name: str, values: Any) -> Any:
    """Numbers of components, NaN for those that are left out. Raises TypeError for what is no number."""
    listed = np.ravel(np.asarray(values, dtype=object))
    for value in listed:
        if value is not None and not _is_number(value):
            raise TypeError(f"{name}: found {value!r}, expected numbers, and None for a component that is left out")
    return np.array([np.nan if value is None else value for value in listed], dtype=float)


def _spread(name: str, given: ArrayLike, shape: tuple[int, ...], allowed: Mapping[tuple[int, ...], str]) -> Any:
    """Returns a number, or an array of one of the allowed shapes, as an array of `shape`. Raises ValueError."""
    for value in np.ravel(np.asarray(given, dtype=object)):
        if not _is_number(value):
            raise TypeError(f"{name}: found {value!r}, expected numbers")
    array = np.asarray(given, dtype=float)
    if array.ndim and array.shape not in allowed:
        raise ValueError(f"{name}: found shape {array.shape}, expected one number, or {' or '.join(allowed.values())}")
    return np.broadcast_to(array.reshape(shape) if array.size == np.prod(shape) else array, shape)


def _deviations(sigma: Any, shape: tuple[int, ...], allowed: Mapping[tuple[int, ...], str]) -> Any:
    """Standard deviations of data, None if they are not stated. Raises TypeError and ValueError."""
    if sigma is None:
        return None
    deviations = _spread("sigma", sigma, shape, allowed)
    if not np.all((deviations > 0) & np.isfinite(deviations)):
        raise ValueError("sigma: expected finite numbers > 0")
    return deviations


@overload
def terminal(target: Any = None, *, weight: ArrayLike = 1.0, mode: str | None = None, min: Any = None, max: Any = None,
             hard: bool = False, body: None = None, quantity: None = None) -> Cost: ...
@overload
def terminal(target: Any = None, *, weight: ArrayLike = 1.0, mode: str | None = None, min: Any = None, max: Any = None,
             hard: bool = False, body: str, quantity: str | None = None) -> dict[str, Any]: ...
def terminal(
    target: Any = None,
    *,
    weight: ArrayLike = 1.0,
    mode: str | None = None,
    min: Any = None,
    max: Any = None,
    hard: bool = False,
    body: str | None = None,
    quantity: str | None = None,
) -> Cost | dict[str, Any]:
    """weight * |x_i - target_i|^2 at the end. NaN or None leaves a component out; weight: a number, or one for each.

    Args:
        hard: the state must be the target there, in place of a cost.
        min, max: a goal region in place of a target: the least and the greatest value of each component, or None.
        mode: in which the motion must end; without one the number of targets must be that of its states.
        body: a disc of a scene, or a body of a box file. The result is then an entry of ``terminal`` in the ``objective`` of
            the scene: ``saltus.terminal(min=[2, -0.1], max=[None, 0.1], body="puck")``.
        quantity: of the body, "position" (the default), "velocity", "angle" or "angular_velocity".
    """
    expect("True or False", hard=hard)
    if body is not None:
        return _scene_term(target, weight, mode, min, max, hard, body, quantity or "position")
    if quantity is not None:
        raise ValueError(f"quantity: found {quantity!r} without a body, expected none: a state has components")
    if min is not None or max is not None:
        if target is not None or hard or np.ndim(weight) > 0 or weight != 1:
            raise ValueError("min and max: found them beside a target, hard or a weight, expected a region alone")
        return _region(min, max, mode)
    targets = _components("target", target)
    if hard and np.any(np.asarray(weight) != 1):
        raise ValueError("weight: found one of a hard target, expected none")
    weights = _spread("weight", weight, targets.shape, {targets.shape: f"{len(targets)}, one for each component of the target"})
    if not np.all((weights >= 0) & np.isfinite(weights)):
        raise ValueError("weight: expected finite numbers >= 0")
    if np.any(np.isinf(targets)):
        raise ValueError("target: expected finite numbers, or None where there is no target")
    used = [i for i in range(len(targets)) if not np.isnan(targets[i])]
    if not used:
        raise ValueError("target: found none, expected at least one number")

    def misses(x: Any) -> Any:
        return [float(np.sqrt(weights[i])) * (x[i] - float(targets[i])) for i in used]

    name, role = ("terminal condition", "equality") if hard else ("terminal cost", "cost")
    return Cost(name, misses, "end", role, mode, None, False, len(targets))


def _scene_term(target: Any, weight: Any, mode: str | None, least: Any, greatest: Any, hard: bool, body: str,
                quantity: str) -> dict[str, Any]:
    """Returns a terminal term of a scene, with the keys of a scene file."""
    expect("text", body=body, quantity=quantity)
    if mode is not None:
        raise ValueError(f"mode: found {mode!r} beside a body, expected none: scenes have no modes")

    def numbers(name: str, given: Any) -> Any:
        components = [None if np.isnan(value) else float(value) for value in _components(name, given)]
        return components[0] if np.ndim(given) == 0 else components

    term: dict[str, Any] = {"body": body, "quantity": quantity}
    if least is not None or greatest is not None:
        if target is not None or hard or np.ndim(weight) > 0 or weight != 1:
            raise ValueError("min and max: found them beside a target, hard or a weight, expected a region alone")
        bounds = {"min": least, "max": greatest}
        return term | {name: numbers(name, given) for name, given in bounds.items() if given is not None}
    if hard and (np.ndim(weight) > 0 or weight != 1):
        raise ValueError("weight: found one of a hard target, expected none")
    goal = numbers("target", target)
    left_out = isinstance(goal, list) and None in goal
    if hard and left_out:  # bounds that are equal
        return term | {"min": goal, "max": goal}
    if left_out:
        raise ValueError("target: found None, expected numbers: only a hard target of a scene leaves a component out")
    return term | {"target": goal} | ({"hard": True} if hard else {"weight": weight})


def _region(least: Any, greatest: Any, mode: str | None) -> Cost:
    """The inequalities of a goal region."""
    size = len(_components("max", greatest) if least is None else _components("min", least))
    low = np.full(size, np.nan) if least is None else _components("min", least)
    high = np.full(size, np.nan) if greatest is None else _components("max", greatest)
    for name, given, bounds in (("min", least, low), ("max", greatest, high)):
        if given is not None and any(value is not None and np.isnan(value) for value in np.ravel(np.asarray(given, dtype=object))):
            raise ValueError(f"{name}: found NaN, expected numbers, and None where there is no bound")
    if len(low) != len(high):
        raise ValueError(f"min and max: found {len(low)} and {len(high)} numbers, expected as many")
    if np.any(low > high):
        raise ValueError(f"min: found {low[low > high][0]:g} above max, expected at most that")
    sides = [(i, sign, bounds[i]) for sign, bounds in ((-1.0, low), (1.0, high)) for i in range(size)
             if np.isfinite(bounds[i])]
    if not sides:
        raise ValueError("min and max: found no finite number, expected at least one")

    def outside(x: Any) -> Any:
        return [sign * (x[i] - float(bound)) for i, sign, bound in sides]

    return Cost("goal region", outside, "end", "inequality", mode, None, False, size)


class _Measurements(Cost):
    """Values of states at given times. Each time has its own function, without the values that are missing."""

    def __init__(self, times: tuple[float, ...], values: Any, states: Any, sigma: Any, quantities: list[str]):
        super().__init__("measurements", states, times, "cost", None, None, False, None)
        self._values, self._quantities, self._given_sigma = values, quantities, sigma
        self._sigma = np.ones(values.shape) if sigma is None else sigma

    def __reduce__(self) -> Any:
        return (_Measurements, (self._times, self._values, self.function, self._given_sigma, self._quantities))

    def _data(self) -> list[tuple[str, float, float, float, bool]]:
        return [(name, time, float(value), float(sigma), self._given_sigma is not None)
                for time, values, sigmas in zip(self._times, self._values, self._sigma)
                for name, value, sigma in zip(self._quantities, values, sigmas) if not np.isnan(value)]

    def _as_recorded(self, problem: HybridProblem) -> Cost:
        if not callable(self.function):
            return self
        kept = copy.copy(self)
        kept.function = [self._recorded(problem, row) for row in range(len(self._times))]
        return kept

    def _recorded(self, problem: HybridProblem, row: int = 0) -> Any:
        if isinstance(self.function, list) and isinstance(self.function[0], tuple):
            return self.function[row]
        if callable(self.function):
            measured = self.function
        else:
            states = problem.system._states_of(problem.mode)
            unknown = [name for name in self.function if name not in states]
            if unknown:
                raise ValueError(f"measurements: found state {unknown[0]!r}, expected some of {', '.join(states)}")
            places = [states.index(name) for name in self.function]

            def measured(x: Any) -> Any:
                return [x[i] for i in places]

        values, sigma = self._values[row], self._sigma[row]

        def misses(x: Any) -> Any:
            found = np.ravel(_as_array(measured(x)))
            if len(found) != len(values):
                raise ValueError(f"found {len(found)} numbers, expected {len(values)}, as many as a row of values has")
            return [(found[i] - float(values[i])) / float(sigma[i]) for i in range(len(values)) if not np.isnan(values[i])]

        return Cost(self.name, misses, self.at, "cost", None, None, False, None)._recorded(problem)

    def _terms(self, problem: HybridProblem) -> list[Any]:
        nodes = problem._nodes_of(self)
        return [_at_node(self._recorded(problem, row), node, problem.intervals) for row, node in enumerate(nodes)
                if not np.all(np.isnan(self._values[row]))]


def measurements(
    times: ArrayLike, values: ArrayLike, states: Sequence[str] | Callable[..., Any], *, sigma: ArrayLike | None = None
) -> Cost:
    """A term that compares a motion with data: the sum of ((state - value) / sigma)^2 over all values.

    times: (N,), any times of the motion of a system without controls; otherwise beginnings of control intervals or the end, which
    ``durations=`` of the problem puts anywhere.
    values: (N, S), or (N,) of one state; NaN is a missing value. states: the names of the S states, or a function of x that
    returns S numbers, which `identify` calls by its name and their place. sigma: the standard deviation of a value: one number, (S,) of one for each state, or one for each value;
    left out, `solve` takes 1, and `identify` estimates it.
    """
    at = _read_times("times", times)
    array = np.array(values, dtype=float)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or len(array) != len(at):
        raise ValueError(f"values: found shape {np.shape(values)}, expected ({len(at)}, S), a row for each time")
    if not callable(states):
        states = _names("states", states)
        if len(states) != array.shape[1]:
            raise ValueError(f"states: found {len(states)}, expected {array.shape[1]}, as many as a row of values has")
    if np.any(np.isinf(array)) or np.all(np.isnan(array)):
        raise ValueError("values: expected finite numbers, and NaN where one is missing")
    rows, columns = array.shape
    if np.ndim(values) == 1:
        allowed = {(rows,): f"({rows},), one for each value"}
    else:
        allowed = {array.shape: f"({rows}, {columns}), one for each value", (columns,): f"({columns},), one for each state"}
    label = getattr(states, "__name__", "measurement").replace("<lambda>", "measurement")
    names = [f"{label} {i + 1}" for i in range(columns)] if callable(states) else states
    return _Measurements(at, array, states, _deviations(sigma, array.shape, allowed), names)


class _EventTimes(Cost):
    """The times of the first, second, ... event of a guard, each compared with its value by a term of its own."""

    def __init__(self, guard: str, mode: str | None, times: Any, sigma: Any):
        super().__init__(f"times of '{guard}'", lambda t: t, "event", "cost", mode, guard, False, None)
        self._seen, self._given_sigma = times, sigma
        self._sigma = np.ones(times.shape) if sigma is None else sigma

    def __reduce__(self) -> Any:
        return (_EventTimes, (self.guard, self.mode, self._seen, self._given_sigma))

    def _data(self) -> list[tuple[str, float, float, float, bool]]:
        return [(self.name, float(time), float(time), float(sigma), self._given_sigma is not None)
                for time, sigma in zip(self._seen, self._sigma) if not np.isnan(time)]

    def _as_recorded(self, problem: HybridProblem) -> Cost:
        return self

    def _terms(self, problem: HybridProblem) -> list[Any]:
        terms = []
        for number, (time, sigma) in enumerate(zip(self._seen, self._sigma)):
            if np.isnan(time):
                continue
            miss = Cost(self.name, lambda t, time=time, sigma=sigma: (t - float(time)) / float(sigma), "event", "cost", self.mode,
                        self.guard, False, None)
            term = miss._recorded(problem)
            terms.append((*term[:6], number, *term[7:]))
        return terms


def event_times(guard: str, times: ArrayLike, *, sigma: ArrayLike | None = None, mode: str | None = None) -> Cost:
    """A term that compares the times of events with data: the sum of ((time - value) / sigma)^2.

    guard: the name of the events, such as "ground", or "hit tip" of a MechanicalSystem. times: (N,), of the first N such
    events of the motion; NaN is one that was not seen. A motion with fewer events has no loss, and further ones do not count.
    sigma: the standard deviation of a time: one number, or one for each time; left out, `solve` takes 1, and `identify`
    estimates it. mode: counts events from this mode only.
    """
    expect("text", guard=guard)
    try:
        values = np.array(times, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(f"times: found {times!r}, expected a list of numbers") from None
    if values.ndim != 1 or np.any(np.isinf(values)) or np.all(np.isnan(values)):
        raise ValueError(f"times: found {times!r}, expected a list of finite numbers, and NaN where one is missing")
    seen = values[~np.isnan(values)]
    if np.any(np.diff(seen) < 0):
        raise ValueError(f"times: found {seen[1:][np.diff(seen) < 0][0]:g} behind a later one, expected rising times")
    deviations = _deviations(sigma, values.shape, {values.shape: f"({len(values)},), one for each time"})
    return _EventTimes(guard, mode, values, deviations)


def effort(weight: float = 1.0) -> Cost:
    """weight * int |u|^2 dt."""
    expect("a number", weight=weight)
    if not 0 <= weight < np.inf:
        raise ValueError("weight: expected a finite number >= 0")

    def forces(u: Any, h: Any) -> Any:
        return [np.sqrt(float(weight) * h) * entry for entry in u]

    return Cost("effort", forces, "steps", "cost", None, None, False, None)


def final_time(weight: float = 1.0) -> Cost:
    """weight * T of the final time T."""
    expect("a number", weight=weight)
    if not 0 <= weight < np.inf:
        raise ValueError("weight: expected a finite number >= 0")

    def price(t: Any) -> Any:
        return [np.sqrt(float(weight) * t)]

    return Cost("final time", price, "end", "cost", None, None, False, None)


class HybridProblem(Closed):
    """A motion of a hybrid system, and what is asked of it. All attributes may be set anew; others are refused. The problem
    keeps copies of arrays. It can be copied and pickled: a pickle has what was recorded in place of the functions of costs.
    Several threads may use one problem.

    system: a saltus.HybridSystem or a saltus.MechanicalSystem.
    mode, initial, parameters, duration: where the motion begins, and the final time, which may be left out if there are
    durations. The mode of a mechanical system may be left out too: it is the one in which a motion from the initial state
    starts under the first control.
    control: (K, controls), held on K intervals; K = 1 and zeros if left out.
    durations: (K,), the lengths of the intervals, whose sum is the duration; equal ones if left out. With
    ``control=run.control, durations=run.durations`` or ``start_from(run)`` the problem has the intervals of a run.
    costs: a list of saltus.terminal, saltus.effort, saltus.final_time and saltus.residuals, or of functions, which are
    residuals at the end.
    optimize, bounds: what ``solve`` changes and within which bounds, unless it is given others: pairs (least, greatest) by
    the names of controls, states and parameters, or by "control" and "duration"; None is no bound.
    tolerance: relative error of final state and event times, for which the number of integration steps is chosen;
    steps_per_interval: that number, if it is not to be chosen.
    wait_behind_guards: a guard below zero at the start counts once it is above zero, and is no error.
    most_events: a motion with more events fails. most_repeats: events of one guard without time passing; with more, the
    motion goes on in the mode that on_accumulation names, or fails.
    """

    _attributes = ("system", "mode", "initial", "parameters", "duration", "control", "durations", "costs", "optimize",
                   "bounds", "tolerance", "steps_per_interval", "wait_behind_guards", "most_events", "most_repeats")
    _arrays = ("initial", "parameters", "control", "durations")

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._arrays:
            _refuse_bools(name, value)
            value = copy.deepcopy(value)  # the caller may write into its array later
        super().__setattr__(name, _listed_costs(value) if name == "costs" else value)

    def __init__(
        self,
        system: System,
        *,
        mode: str | None = None,
        initial: ArrayLike,
        parameters: ArrayLike = (),
        duration: float | None = None,
        control: ArrayLike | None = None,
        durations: ArrayLike | None = None,
        costs: Sequence[Any] = (),
        optimize: Sequence[str] = ("control",),
        bounds: Mapping[str, Any] | None = None,
        tolerance: float = 1e-12,
        steps_per_interval: int = 0,
        wait_behind_guards: bool = False,
        most_events: int = 100_000,
        most_repeats: int = 100,
    ):
        if not isinstance(system, System):
            raise TypeError(
                f"system: found {type(system).__name__}, expected a saltus.HybridSystem or a saltus.MechanicalSystem"
            )
        if mode is None and isinstance(system, HybridSystem):
            raise TypeError(f"mode: found none, expected one of {', '.join(system.modes)}")
        if duration is None:
            if durations is None:
                raise TypeError("duration: found none and no durations, expected one of them")
            duration = float(np.sum(np.asarray(durations, dtype=float)))
        expect("a number", duration=duration)
        self.system, self.mode, self.duration = system, mode, duration
        self.durations: Any = durations
        self.initial: Any = initial
        self.parameters: Any = parameters
        self.control: Any = control
        self.costs = costs
        self.optimize, self.bounds = optimize, {} if bounds is None else bounds
        self.tolerance, self.steps_per_interval = tolerance, steps_per_interval
        self.wait_behind_guards = wait_behind_guards
        self.most_events, self.most_repeats = most_events, most_repeats
        self._made: tuple[Any, Any] | None = None
        self._call("check")
        _check_bounds(self.bounds, {*system.controls, *system._states_of(mode), *system.parameters, "control", "duration"})
        self.bounds = dict(self.bounds)
        self._free(self.optimize)

    def _call(self, method: str, *arguments: Any) -> Any:
        """Calls a method of what evaluates it, which is kept as long as only the guess changes."""
        number = self.system._mode_number(self.mode)
        expect("a number", duration=self.duration)
        if self.duration > self.system._longest * (1 + 1e-9):
            raise ValueError(f"duration: found {self.duration:.10g}, expected at most {self.system._longest:.10g}, at which a prescribed "
                             "motion of the scene ends; give it further times and positions")
        guess = (number, self.initial, self.parameters, float(self.duration),
                 *self._intervals())
        expect("a number", tolerance=self.tolerance)
        expect_int(steps_per_interval=self.steps_per_interval, most_events=self.most_events, most_repeats=self.most_repeats)
        expect("True or False", wait_behind_guards=self.wait_behind_guards)
        limits = (self.tolerance, self.steps_per_interval, self.wait_behind_guards, self.most_events, self.most_repeats)
        nodes = tuple(self._nodes_of(cost) for cost in self.costs if isinstance(cost, Cost) and cost._times)
        rest = (self.system, tuple(self.costs), nodes, *limits)
        made = self._made
        if made is None or len(made[0]) != len(rest) or any(
            a is not b and not (isinstance(a, (tuple, float, int)) and a == b) for a, b in zip(made[0], rest)
        ):
            terms = [term for cost in self._costs() for term in cost._terms(self)]
            self._made = made = (rest, _saltus.HybridProblem(self.system._system, terms, *limits))
        return getattr(made[1], method)(guess, *arguments)

    def __repr__(self) -> str:
        begin = "" if self.mode is None else f"from mode '{self.mode}', "
        return (f"<saltus.HybridProblem {begin}{self.intervals} control intervals over {self.duration:g}, "
                f"{len(self.costs)} costs and constraints>")

    def _costs(self) -> list[Cost]:
        return [cost if isinstance(cost, Cost) else residuals(cost) for cost in self.costs]

    def __copy__(self) -> HybridProblem:
        copied = type(self).__new__(type(self))
        copied.__dict__ = {**self.__dict__, "costs": list(self.costs), "_made": None}
        for name in self._arrays:
            setattr(copied, name, getattr(self, name))
        return copied

    def __deepcopy__(self, memo: dict[int, Any]) -> HybridProblem:
        copied = type(self).__new__(type(self))
        copied.__dict__ = copy.deepcopy({**self.__dict__, "_made": None}, memo)
        return copied

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "costs": [cost._as_recorded(self) for cost in self._costs()], "_made": None}

    def _intervals(self) -> tuple[Any, Any]:
        """The control, and the lengths of its intervals; None: equal ones. Without controls, intervals begin at the times of terms,
        too."""
        control, lengths = self._given_intervals()
        if self.system.controls:
            return control, lengths
        nodes = self._nodes(control, lengths)
        times = np.array([time for cost in self._costs() for time in cost._times if 0 < time < self.duration])
        new = [time for time in np.unique(times) if np.min(np.abs(nodes - time)) > 1e-9 * self.duration]
        if not new:
            return control, lengths
        divided = np.sort(np.concatenate([nodes, new]))
        return np.zeros((len(divided) - 1, 0)), np.diff(divided)

    def _given_intervals(self) -> tuple[Any, Any]:
        """The control, and the lengths of its intervals as they were given. A run's control brings its own."""
        durations = getattr(self.control, "durations", None) if self.durations is None else self.durations
        if durations is None:
            return self.control, None
        try:
            lengths = np.asarray(durations, dtype=float)
        except (TypeError, ValueError):
            raise TypeError(f"durations: found {durations!r}, expected a list of numbers") from None
        intervals = 1 if self.control is None else len(np.asarray(self.control))
        if self.control is None or lengths.shape != (intervals,):
            raise ValueError(f"durations: found shape {lengths.shape}, expected ({intervals},), one for each row of the control")
        if not np.all(lengths > 0) or not np.all(np.isfinite(lengths)):
            raise ValueError("durations: expected finite numbers > 0")
        if abs(np.sum(lengths) - self.duration) > 1e-9 * abs(self.duration):
            raise ValueError(
                f"durations: found a sum of {np.sum(lengths):.10g}, expected the duration, {self.duration:.10g}; set both, or use "
                "start_from(run)"
            )
        return np.asarray(self.control), lengths

    def _nodes(self, control: Any, lengths: Any) -> Any:
        """The times at which control intervals begin, and the final time."""
        K = 1 if control is None else len(np.asarray(control))
        return np.concatenate([[0.0], np.cumsum(np.full(K, self.duration / K) if lengths is None else lengths)])

    def _nodes_of(self, cost: Cost) -> tuple[int, ...]:
        """The control intervals at whose beginnings the times of a term are; their number K stands for the end."""
        nodes = self._nodes(*self._intervals())
        found = []
        for time in cost._times:
            node = int(np.argmin(np.abs(nodes - time)))
            if abs(nodes[node] - time) > 1e-9 * self.duration:
                raise ValueError(
                    f"{cost.name}: found the time {time:.10g}, expected the beginning of a control interval or the end, such "
                    f"as {nodes[node]:.10g}; durations= of the problem puts intervals anywhere"
                )
            found.append(node)
        return tuple(found)

    def start_from(self, run: HybridRun) -> None:
        """Takes over the solution of a run: initial state, control and its intervals, parameters and duration."""
        if not isinstance(run, HybridRun):
            raise TypeError(f"run: found {type(run).__name__}, expected a HybridRun")
        if "control" not in run:
            raise ValueError(f"run: found none with a solution: {run.get('reason', '')}")
        self.control, self.durations = np.asarray(run.control), run.durations
        self.initial, self.parameters, self.duration = run.initial, run.parameters, run.duration
        self._call("check")

    def _begun_by(self, run: HybridRun, optimize: Sequence[str]) -> HybridProblem:
        """The problem with what is free of its control, initial state, parameters and duration from a run."""
        if not isinstance(run, HybridRun):
            raise TypeError(f"start: found {type(run).__name__}, expected a HybridRun")
        of_run = self._from(run)
        control, initial, parameters, duration = self._free(optimize)
        problem = copy.copy(self)
        if duration:
            problem.duration = of_run.duration
        if control:
            problem.control = of_run.control
        stretched = control or (duration and self.durations is not None)
        if stretched:
            lengths = np.asarray(of_run.durations if control else self.durations, dtype=float)
            problem.durations = lengths * (problem.duration / np.sum(lengths))
        for name, free in (("initial", initial), ("parameters", parameters)):
            values = np.array(getattr(self, name), dtype=float)
            values[free] = np.asarray(getattr(of_run, name), dtype=float)[free]
            setattr(problem, name, values)
        return problem

    def _from(self, run: HybridRun) -> HybridProblem:
        """The same problem from the solution of a run."""
        problem = copy.copy(self)
        problem.start_from(run)
        return problem

    @property
    def intervals(self) -> int:
        """K, those that begin at times of terms of systems without controls included."""
        control, _ = self._intervals()
        return 1 if control is None else len(np.asarray(control))

    def _free(self, optimize: Sequence[str]) -> tuple[bool, list[int], list[int], bool]:
        """What is free: control, components of the initial state, parameters, duration."""
        if isinstance(optimize, str):
            optimize = [optimize]
        if isinstance(optimize, Mapping) or not isinstance(optimize, Iterable):
            raise TypeError(f"optimize: found {optimize!r}, expected a list of names; bounds are given by bounds={{name: (min, max)}}")
        states, parameters = self.system._states_of(self.mode), self.system.parameters
        initial: list[int] = []
        free: list[int] = []
        for name in optimize:
            if name == "initial":
                initial += range(len(states))
            elif name == "parameters":
                free += range(len(parameters))
            elif name in states:
                initial.append(states.index(name))
            elif name in parameters:
                free.append(parameters.index(name))
            elif name not in ("control", "duration"):
                raise ValueError(
                    f"optimize: found {name!r}, expected some of control, initial, parameters, duration, "
                    f"{', '.join([*states, *parameters])}"
                )
        if "duration" in optimize:
            for cost in self._costs():
                if cost._times:
                    raise ValueError(
                        f"optimize: found the duration, with which the times of '{cost.name}' would move; expected a fixed one"
                    )
        return "control" in optimize, initial, free, "duration" in optimize

    def _bounds(self, bounds: Mapping[str, Any] | None, free: Any) -> list[list[tuple[float, float]]]:
        """Pairs for all that is free; None: the bounds of the problem that are of what is free."""
        states, parameters = self.system._states_of(self.mode), self.system.parameters
        groups = [self.system.controls if free[0] else [], [states[i] for i in free[1]],
                  [parameters[i] for i in free[2]], ["duration"] if free[3] else []]
        known = {name for group in groups for name in group} | ({"control"} if free[0] else set())
        if bounds is None:
            bounds = {name: pair for name, pair in self.bounds.items() if name in known}
        checked = _check_bounds(bounds, known)
        result = []
        for number, group in enumerate(groups):
            every = checked.get("control") if number == 0 else None
            found = [checked.get(name, every) for name in group]
            none = (-np.inf, np.inf) if group != ["duration"] else (0.0, np.inf)
            result.append([pair or none for pair in found] if any(pair is not None for pair in found) else [])
        return result


def _check_bounds(bounds: Any, known: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Returns bounds as pairs of numbers, infinite where there is none. Raises TypeError and ValueError."""
    if not isinstance(bounds, Mapping):
        raise TypeError(f"bounds: found {type(bounds).__name__}, expected a dict of pairs (least, greatest) by names")
    pairs = {}
    for name, pair in bounds.items():
        if name not in known:
            raise ValueError(f"bounds: found {name!r}, expected some of what is optimized: {', '.join(sorted(known))}")
        listed = list(pair) if isinstance(pair, (Sequence, np.ndarray)) and np.ndim(pair) else []
        if len(listed) != 2 or not all(end is None or _is_number(end) for end in listed):
            raise ValueError(f"bounds of {name!r}: found {pair!r}, expected a pair of numbers (least, greatest); None is no bound")
        low, high = (infinite if end is None else float(end) for end, infinite in zip(listed, (-np.inf, np.inf)))
        if not (low <= high and low < np.inf and high > -np.inf):
            rule = "no NaN" if np.isnan(low) or np.isnan(high) else "the least one first, and a finite number between them"
            raise ValueError(f"bounds of {name!r}: found {low:g} and {high:g}, expected {rule}")
        pairs[name] = (low, high)
    return pairs


def _finite(value: Any) -> Any:
    """What JSON can hold: without numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _finite(held) for key, held in value.items()}
    if isinstance(value, list):
        return [_finite(held) for held in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


class _Paged(Result):
    """A result of a problem that has a page."""

    _problem: HybridProblem | None = None
    _found: dict[str, Any] | None = None  # of a run: as programs have it
    _control_bounds: list[tuple[float, float]] | None = None  # of a run: those it kept; empty without any

    def save_page(self, folder: str | os.PathLike[str], *, draw: Callable[..., Any] | None = None) -> None:
        """Writes the page that programs write, ``report.html``, and its numbers, ``result.json``, to a folder.

        The page shows states, guards and control over time, events, the loss and its gradient, and of a run the solution. It
        has a replay if there is a drawing.

        Args:
            folder: is made if there is none.
            draw: as of a system, whose own is taken if this is None.

        Raises:
            ValueError: this result was read from a file or a pickle, which do not have its problem.
        """
        if self._problem is None:
            raise ValueError("save_page: found a result without its problem; expected one that rollout or solve has returned")
        problem = self._problem
        expect("a callable", draw=draw)
        document = {"program": "saltus", **problem._call("page_document"), "runs": [], "audits": []}
        pairs = self._control_bounds
        if pairs is None:
            pairs = problem._bounds(None, (True, [], [], False))[0]
        if pairs:
            document["control_bounds"] = {"min": [low for low, _ in pairs], "max": [high for _, high in pairs]}
        drawn = [(problem, document)]
        if self._found is not None:
            run = dict(self._found)
            document["runs"].append(run)
            if "solution" in run:
                solved = problem._from(self)
                of_solution = solved._call("page_document")
                run["motion"] = of_solution["motion"]
                document["system"] = of_solution["system"]  # with the modes of its motion
                drawn.append((solved, run))
        os.makedirs(folder, exist_ok=True)
        plain = _finite(document)
        with open(os.path.join(folder, "result.json"), "w", encoding="utf-8") as file:
            json.dump(plain, file, indent=1)
        function = draw or problem.system.draw
        for of, part in drawn if function is not None else []:
            motion = part["motion"]
            motion["frames"] = [
                of.system._frame(function, mode, t, np.array(x), np.array(of.parameters, dtype=float))
                for t, mode, x in zip(motion["times"], motion["modes"], motion["states"])
            ]
        with open(os.path.join(folder, "report.html"), "w", encoding="utf-8") as file:
            file.write(_saltus.render_page(json.dumps(_finite(document))))


class HybridRollout(_Paged):
    """A motion of a hybrid system: ``mode`` and ``final``, the state at the end, after events there; ``events``, a list
    of (time, mode, guard, next_mode); ``switches``, a list of (time, mode, number) where a condition of a function
    changes, as its number is zero or an integer; ``times``, ``modes``, ``states`` and ``guards`` at every step of the
    integration, and before and after every event. ``integration_error``: relative, of final state and event times.
    ``remark``: why there is no derivative, or only a one-sided one, and why the error is above the tolerance; empty if
    neither is so. ``remarks``: the list of all remarks."""

    _kind = "hybrid rollout"


class HybridGradient(Result):
    """``loss``, and ``gradient`` with ``initial`` (n,), ``control`` (K, m), ``parameters`` (P,) and ``duration``;
    ``remark`` and ``remarks`` as of a rollout."""

    _kind = "hybrid gradient"


class HybridRun(_Paged):
    """What a solver found: ``loss``, None of a run that failed; ``control`` (K, m), ``durations`` of the K intervals, ``initial``, ``parameters``,
    ``duration``, ``mode``, ``final`` and ``events`` of its motion; ``termination``, ``reason``, ``losses``,
    ``iterations``, ``integration_error``, ``remarks``; ``certificate`` of a run that converged, and of solvers that certify
    all they find, otherwise None."""

    _kind = "hybrid run"

    @property
    def control(self) -> Any:
        """The control, (K, m)."""
        control, durations = self.__getattr__("control"), self.__getattr__("durations")
        equal = np.ptp(durations) <= 1e-9 * np.mean(durations)
        return control if equal else on_intervals(control, durations)


KINDS[HybridRun._kind] = HybridRun


def _events(motion: Mapping[str, Any]) -> list[tuple[float, str, str, str]]:
    return [(e["time"], e["mode"], e["guard"], e["next_mode"]) for e in motion["events"]]


def _motion(motion: dict[str, Any]) -> dict[str, Any]:
    if "failed" in motion:
        error = RuntimeError(motion["failed"])
        error.accumulation = motion.get("accumulation")  # type: ignore[attr-defined]
        raise error
    return {
        "mode": motion["mode"],
        "final": np.array(motion["final"]),
        "events": _events(motion),
        "times": np.array(motion["times"]),
        "modes": motion["modes"],
        "states": [np.array(state) for state in motion["states"]],
        "guards": [np.array(values) for values in motion["guards"]],
        "steps_per_interval": motion["steps_per_interval"],
        "switches": [(s["time"], s["mode"], s["switch"]) for s in motion.get("switches", [])],
        "integration_error": _error(motion["integration_error"]),
        "remark": motion.get("remark", ""),
        "remarks": motion["remarks"],
    }


def _error(value: float | None) -> float:
    """An error of the integration; JSON has no infinity."""
    return float("inf") if value is None else value


def rollout(problem: HybridProblem) -> HybridRollout:
    motion = HybridRollout(_motion(problem._call("rollout")))
    motion._problem = copy.copy(problem)
    return motion


def final_derivatives(problem: HybridProblem) -> Result:
    """The derivatives of the final state (n,) of a hybrid problem: ``by_initial`` (n, n0), ``by_control`` (n, K, m),
    ``by_parameters`` (n, P), ``by_duration`` (n,); and those of the times of the events: ``times_by_initial`` (E, n0)
    and so on. ``remark`` gives the reason why there is no derivative, or only a one-sided one; empty if there is. Where
    derivatives are not finite it names function, mode, time and variable.

    The control is held on K equal parts of the duration, which grow with it. Raises RuntimeError for a motion that
    fails, with mode, guard and time.
    """
    if not isinstance(problem, HybridProblem):
        raise TypeError(f"problem: found {type(problem).__name__}, expected a saltus.HybridProblem")
    final, times, remark, error = problem._call("final_derivatives")
    system = problem.system
    n0, K, m, P = len(system._states_of(problem.mode)), problem.intervals, len(system.controls), len(system.parameters)
    found: dict[str, Any] = {}
    for prefix, rows in (("by_", final), ("times_by_", times)):
        found[prefix + "initial"] = rows[:, :n0]
        found[prefix + "control"] = rows[:, n0 : n0 + K * m].reshape(len(rows), K, m)
        found[prefix + "parameters"] = rows[:, n0 + K * m : n0 + K * m + P]
        found[prefix + "duration"] = rows[:, -1]
    found["integration_error"], found["remark"] = error, remark
    return Result(found)


def loss_and_gradient(problem: HybridProblem) -> HybridGradient:
    loss, gradient, remark, remarks = problem._call("loss_and_gradient")
    system = problem.system
    n0, K, m, P = len(system._states_of(problem.mode)), problem.intervals, len(system.controls), len(system.parameters)
    parts = {
        "initial": gradient[K * m : K * m + n0],
        "control": gradient[: K * m].reshape(K, m),
        "parameters": gradient[K * m + n0 : K * m + n0 + P],
        "duration": float(gradient[-1]),
    }
    return HybridGradient({"loss": loss, "gradient": parts, "remark": remark, "remarks": remarks})


class HybridBatch(Closed):
    """Losses and gradients of a hybrid problem at many points, on all cores: many controls, initial states, parameters.

    The results are bit by bit those of ``loss_and_gradient`` of one problem for each point, for any number of threads: the
    integration steps of each point are chosen by themselves, unless the problem has ``steps_per_interval``, which is
    faster. Where a motion fails, loss and gradient are NaN.

    Args:
        problem: a HybridProblem, of which a copy is kept.
        optimize: what a point consists of, as in ``solve``: some of "control", "initial", "parameters", "duration" and the
            names of initial states and parameters; default: that of the problem.
        threads: number of threads; 0 is one per core.
        progress: whether a line on stderr shows the progress after two seconds; default: on terminals and in notebooks.

    Attributes:
        variables: the names of the n numbers of a point, in order: the control interval by interval, as "u[3]" of the
            fourth one, initial states, parameters, and the duration.
        num_variables: n.
        failures: the reasons why points of the last call have no loss or gradient, by their numbers.
        remarks: why gradients of the last call are one-sided or do not exist, by the numbers of their points; a
            RuntimeWarning tells their number and the first one.
    """

    _attributes = ("problem", "optimize", "threads", "progress", "variables", "num_variables", "failures", "remarks")

    def __init__(self, problem: HybridProblem, *, optimize: Sequence[str] | None = None, threads: int = 0,
                 progress: bool | None = None):
        if not isinstance(problem, HybridProblem):
            raise TypeError(f"problem: found {type(problem).__name__}, expected a saltus.HybridProblem")
        expect_int(threads=threads)
        if threads < 0:
            raise ValueError(f"threads: found {threads}, expected at least 0 (0 is one per core)")
        CountedProgress("batch", progress)
        self.problem, self.threads, self.progress = copy.copy(problem), threads, progress
        self.optimize = problem.optimize if optimize is None else optimize
        control, initial, parameters, duration = problem._free(self.optimize)
        system, states = problem.system, problem.system._states_of(problem.mode)
        self.variables = [f"{name}[{k}]" for k in range(problem.intervals) for name in system.controls] if control else []
        self.variables += [states[i] for i in initial] + [system.parameters[i] for i in parameters]
        self.variables += ["duration"] if duration else []
        self.num_variables = len(self.variables)
        self.failures: dict[int, str] = {}
        self.remarks: dict[int, str] = {}

    def _losses(self, points: ArrayLike, with_gradients: bool) -> tuple[Any, Any]:
        free = self.problem._free(self.optimize)
        with CountedProgress("batch", self.progress) as shown:
            losses, gradients, self.failures, self.remarks = self.problem._call(
                "losses", *free, points, with_gradients, self.threads, shown.counter)
        for point, remark in itertools.islice(self.remarks.items(), 1):
            warnings.warn(f"{len(self.remarks)} of {len(losses)} gradients have remarks; that of point {point}: {remark}",
                          RuntimeWarning, stacklevel=3)
        return losses, gradients

    def loss(self, points: ArrayLike) -> Any:
        """Returns the losses (P,) at points (P, n). A control may have its shape, (P, K, m)."""
        return self._losses(points, False)[0]

    def loss_and_gradient(self, points: ArrayLike) -> tuple[Any, Any]:
        """Returns the losses, and the gradients in the shape of the points."""
        losses, gradients = self._losses(points, True)
        return losses, gradients.reshape(np.shape(points))

    def __repr__(self) -> str:
        return f"<saltus.HybridBatch of {self.num_variables} variables, {self.problem!r}>"


class HybridEndState(Closed):
    """The final state of a hybrid problem as a function of initial state, control and parameters, for automatic
    differentiation by other packages, such as those of saltus.torch and saltus.jax.

    ``end(initial, control, parameters)`` returns the state at the end, after events there, of shape (n,).
    ``end.vjp(initial, control, parameters, cotangent)`` returns the gradients of sum(cotangent * end(...)) by all three, by
    one adjoint through all events. Each call chooses the integration steps, unless the problem has them. Where derivatives
    are one-sided, or do not exist, a RuntimeWarning gives the reason, as ``remark`` of ``final_derivatives`` does.
    """

    _attributes = ("problem",)

    def __init__(self, problem: HybridProblem):
        if not isinstance(problem, HybridProblem):
            raise TypeError(f"problem: found {type(problem).__name__}, expected a saltus.HybridProblem")
        self.problem = copy.copy(problem)
        if self.problem.control is None:
            self.problem.control = np.zeros((1, len(problem.system.controls)))

    @property
    def initial(self) -> Any:
        """The initial state of the problem, (n0,)."""
        return np.array(self.problem.initial, dtype=float)

    @property
    def control(self) -> Any:
        """The control of the problem, (K, m)."""
        return np.array(self.problem.control, dtype=float)

    @property
    def parameters(self) -> Any:
        """The parameters of the problem, (P,)."""
        return np.array(self.problem.parameters, dtype=float)

    def _at(self, initial: Any, control: Any, parameters: Any, cotangent: Any) -> Any:
        problem = copy.copy(self.problem)
        problem.initial, problem.parameters = initial, parameters
        shape = self.control.shape
        if np.size(control) != np.prod(shape):
            raise ValueError(f"control: found shape {np.shape(control)}, expected {shape}, as the problem of this HybridEndState has; make "
                             "another one for other intervals")
        problem.control = np.reshape(control, shape)
        return problem._call("end_state", cotangent)

    def __call__(self, initial: ArrayLike, control: ArrayLike, parameters: ArrayLike) -> Any:
        return self._at(initial, control, parameters, None)[0]

    def vjp(self, initial: ArrayLike, control: ArrayLike, parameters: ArrayLike, cotangent: ArrayLike) -> Any:
        return self._at(initial, control, parameters, cotangent)[1:]


def hybrid_solvers() -> dict[str, str]:
    """The solvers of hybrid problems, each with one line about it."""
    return _saltus.hybrid_solvers()


def _sequence(problem: HybridProblem, events: Any) -> list[tuple[int, int]]:
    """The numbers of modes and guards of a sequence of events, and at last the mode at the end."""
    if isinstance(events, str) or not isinstance(events, Iterable):
        raise TypeError(f"sequence: found {events!r}, expected a list of names of events")
    names = list(events)
    for name in names:
        if not isinstance(name, str) and not (isinstance(name, tuple) and len(name) == 2):
            raise TypeError(f"sequence: found {name!r}, expected the name of an event, or a pair of it and the next mode")
    system = problem.system
    mode = problem.mode if problem.mode is not None else rollout(problem)["modes"][0]
    found = system._find_sequence(mode, names, np.asarray(problem.parameters, dtype=float).tolist())
    if found is None:
        raise ValueError(
            f"sequence: found {names}, which no modes have from mode '{mode}' on, whose events are "
            f"{', '.join(system._guards_of(mode))}"
        )
    last = (system._mode_number(found[-1][0]), -1)
    return [*((system._mode_number(at), system._guards_of(at).index(guard)) for at, guard in found[:-1]), last]


def solve(
    problem: HybridProblem,
    solver: str,
    optimize: Sequence[str],
    bounds: Mapping[str, Any] | None,
    iterations: int,
    learning_rate: float,
    guess_states: Any,
    callback: Any,
    sequence: Any,
    seconds: float,
) -> HybridRun:
    free = problem._free(optimize)
    along = None if sequence is None else _sequence(problem, sequence)
    states = [] if guess_states is None else np.asarray(guess_states, dtype=float)
    width = len(problem.initial)
    if guess_states is not None and (states.ndim != 2 or states.shape[1] != width or len(states) < 2):
        raise ValueError(f"guess_states: found an array of shape {states.shape}, expected (R, {width}) with R >= 2")
    pairs = problem._bounds(bounds, free)
    found, stopped_by = problem._call(
        "solve", solver, *free, pairs, iterations, learning_rate, np.ravel(states).tolist(), callback,
        along, float(seconds)
    )
    data = {"solver": found["solver"], "termination": found["termination"], "reason": found.get("reason", ""),
            "remarks": found.get("remarks", []), "loss": None}
    if "solution" in found:
        solution, motion = found["solution"], found["motion"]
        control = np.array(solution["control"], dtype=float)
        data |= {
            "loss": found["final_loss"],
            "initial_loss": found["initial_loss"],
            "losses": np.array(found["losses"], dtype=float),
            "iterations": found["iterations"],
            "evaluations": found["evaluations"],
            "seconds": found["seconds"],
            "integration_error": _error(found["integration_error"]),
            "control": control.reshape(solution["intervals"], len(problem.system.controls)),
            "durations": np.array(found["durations"]),
            "initial": np.array(solution["initial"]),
            "parameters": np.array(solution["parameters"]),
            "duration": solution["duration"],
            "mode": motion.get("mode"),
            "final": np.array(motion.get("final", [])),
            "events": _events(motion),
        }
    data["certificate"] = found.get("certificate")
    run = HybridRun(data)
    run._problem, run._found, run._control_bounds = copy.copy(problem), found, pairs[0]
    if stopped_by is not None:
        stopped_by.run = run
        raise stopped_by
    return run


class HybridAudit(Result):
    """``verdict`` of a time-stepping scheme ("right", "consistent", "wrong" ...) and its ``reason``; ``order`` of its
    gradient's error in the step, ``parts`` with errors by number of steps, ``first_wrong`` and ``segments``,
    ``gradient`` and ``exact_gradient``, ``width_sweep`` if asked for."""

    _kind = "hybrid audit"

    def raise_if_wrong(self) -> None:
        """Raises WrongGradient if the verdict is that the gradient is wrong."""
        found = {"wrong": "is wrong", "wrong sign": "has the wrong sign"}.get(self._data["verdict"])
        if found:
            raise WrongGradient(f"{self._data['scheme']}: the gradient {found}: {self._data.get('reason', '')}")


# The arguments of a step of a time-stepping scheme.
_STEP = ["mode", "t", "x", "u", "p", "h"]

# Steps times samples of a level of refinement, of schemes that are called.
_BUDGET = 2e4


def audit(
    problem: HybridProblem, step: Any, jacobian: Any, simulate: Any, steps: int, width_sweep: bool, name: str,
    audit_seconds: float, seconds: float
) -> HybridAudit:
    expect_int(steps=steps)
    if not 0 <= audit_seconds < np.inf:
        raise ValueError("audit_seconds: expected seconds, or 0 for no limit")
    if simulate is not None and (step is not None or not isinstance(simulate, str)):
        raise ValueError("simulate: expected a command, and no step with it, of a HybridProblem")
    if simulate is None and not callable(step):
        raise TypeError("step: expected a function (mode, x, u, p, h) or (mode, t, x, u, p, h)")

    def of_step(what: str, function: Any) -> Any:
        """`function` with the arguments (mode, t, x, u, p, h)."""
        if function is None:
            return None
        if not callable(function):
            raise TypeError(f"{what}: found {type(function).__name__}, expected a function")
        parameters = parameters_of(function) or {}
        required = [p for p in parameters.values() if p.default is p.empty]
        order = _STEP if len(required) == len(_STEP) else [name for name in _STEP if name != "t"]
        try:
            positional, keywords = asked_for(function, {name: name for name in _STEP}, order)
        except ValueError as error:
            raise _at(what, error) from error

        def call_step(*values: Any) -> Any:
            given = dict(zip(_STEP, values))
            result = function(*(given[name] for name in positional), **{name: given[name] for name in keywords})
            is_pair = isinstance(result, (tuple, list)) and len(result) == 2 and isinstance(result[0], str)
            if what == "step" and not is_pair:
                raise ValueError(f"step: found {result!r}, expected the next mode's name and its state")
            return result

        return call_step

    found = problem._call(
        "audit", name, of_step("step", step), of_step("jacobian", jacobian), simulate or "", steps, width_sweep, _BUDGET,
        float(audit_seconds), float(seconds)
    )
    return HybridAudit(found)


class _GivenTerm(Cost):
    """A term of a system that has its functions in C++, by its number."""

    def __init__(self, system: Any, number: int):
        self._given_by, self._number = system, number
        term = self._recorded(None)
        super().__init__(term.name, lambda: None, term.at, term.role, None, None, False, None)

    def __reduce__(self) -> Any:
        return (_GivenTerm, (self._given_by, self._number))

    def _as_recorded(self, problem: Any) -> Cost:
        return self

    def _recorded(self, problem: Any) -> Any:
        return self._given_by._read["terms"][self._number]


def problem_of(system: Any) -> HybridProblem:
    """Returns the problem that was read with a system: its motion, terms, unknowns and bounds are in ``system._read``."""
    read = system._read
    mode = system.modes[0] if isinstance(system, HybridSystem) else None
    states = system._states_of(mode)
    control, initial, parameters, duration = read["free"]
    optimize = [*(["control"] if control else []), *(states[i] for i in initial),
                *(system.parameters[i] for i in parameters), *(["duration"] if duration else [])]
    bounds = {name: pair for name, *pair in zip(system.controls, *read["control_bounds"])} if control else {}
    bounds.update((system.parameters[i], pair) for i, *pair in zip(parameters, *read["parameter_bounds"]))
    if duration:
        bounds["duration"] = list(read["duration_bounds"])
    return HybridProblem(
        system, mode=mode, initial=read["initial"], parameters=read["values"], duration=read["duration"],
        control=read["control"], costs=[_GivenTerm(system, number) for number in range(len(read["terms"]))],
        optimize=optimize, bounds=bounds)


class _SceneSystem(HybridSystem):
    """The system of a scene of discs, which has its functions in C++. It is pickled by the scene."""

    def __init__(self, scene: Scene):
        self._scene, self.sliding = scene, None
        keys = scene.to_dict()
        paths = [body["path"] for body in keys["bodies"] if body.get("path")]
        paths += [plane["motion"] for plane in keys["planes"] if plane.get("motion")]
        self._longest = min((path["times"][-1] for path in paths), default=np.inf)
        self._system = self._make()
        self.states, self.guards = self._read["states"], self._read["guards"]
        self.modes, self.controls, self.parameters = list(self.states), self._read["controls"], self._read["parameters"]
        self._next_modes = self._read["next_modes"]

    def _make(self) -> Any:
        self._read = _saltus.scene_as_hybrid(self._scene)
        return self._read["system"]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in super().__getstate__().items() if name != "_read"}


def hybrid_problem(scene: SceneLike) -> HybridProblem:
    """Returns a scene of discs as a HybridProblem, whose ``costs`` may grow by any that hybrid problems have.

    The motion is that of the contact model "event", in the units of the scene, with its objective, bounds, constraints and
    unknowns. States are named as "puck.x", "puck.vx", controls as "striker.fx", events as "striker-puck"; a waypoint is an
    event "waypoint 1". Terms at events, constraints that hold always, costs of one's own, fits and regulators of hybrid
    problems work for the scene then.

        >>> problem = saltus.hybrid_problem(scene)
        >>> problem.costs += [saltus.cost(lambda x: 0.1 * x[2] ** 2, at="event", guard="striker-puck")]

    Args:
        scene: a Scene, the path of its file, or a dict with its keys.

    Raises:
        SceneError: the scene is wrong.
        ValueError: the scene has walls that end, pockets, a table that slows discs, or terms or springs of a fixed disc whose
            position is a parameter.
    """
    return problem_of(_SceneSystem(as_scene(scene)))
