"""Mechanical systems that users define: masses, forces and contacts as ordinary functions."""

from __future__ import annotations

import json
import os
from typing import Any, Callable, Mapping, Sequence

import numpy as np

from . import _saltus
from ._expression import Tape, _as_array
from ._hybrid import HybridProblem, System, _call, _named, _names, _outputs, problem_of
from ._scene import _plain
from ._types import Closed, expect, expect_path

_LAWS = ("newton", "poisson")
_EVENTS = ("hit", "off", "stop", "break-", "break+", "end", "jam", "grip")  # those of C++, before the name of a contact
_REST_SPEED = 1e-5  # that of C++


class Contact(Closed):
    """A contact of a mechanical system, from functions of some of q and p.

    gap: the distance, which stays >= 0. It may decide by conditions, as of the nearest of several edges, if it is
    continuous and has no kink where it is zero.
    slide: the tangential coordinate, whose rate is the sliding velocity, in the metric of the gap: if the gap is a
    distance times c(q), so is this. slide_row: in the place of it the row T (n,) itself, for which T v is the sliding
    velocity, where that is not the rate of a coordinate. Without both the contact has no friction.
    restitution, friction: e in [0, 1] and mu >= 0: a number, the name of a parameter, or a function of p.
    reach: is above zero while the closed contact stays on what the gap is measured from, such as an edge; the contact
    opens where it falls through zero. distance: the gap continued smoothly past that end, where the gap has a kink there.
    """

    _attributes = ("gap", "slide", "restitution", "friction", "slide_row", "reach", "distance")

    def __init__(
        self,
        gap: Callable[..., Any],
        *,
        restitution: float | str | Callable[..., Any],
        slide: Callable[..., Any] | None = None,
        friction: float | str | Callable[..., Any] | None = None,
        slide_row: Callable[..., Any] | None = None,
        reach: Callable[..., Any] | None = None,
        distance: Callable[..., Any] | None = None,
    ):
        if slide is not None and slide_row is not None:
            raise ValueError("slide: found it beside slide_row, expected one of them")
        slides = slide is not None or slide_row is not None
        if friction is not None and not slides:
            raise ValueError("friction: found it without slide, expected the tangential coordinate as slide=, or slide_row=")
        if friction is None and slides:
            raise ValueError("slide: found it without friction, expected friction=; leave slide out if there is none")
        for name, value, greatest in (("restitution", restitution, 1.0), ("friction", friction, np.inf)):
            if isinstance(value, str) or callable(value) or (name == "friction" and value is None):
                continue
            expect("a number", **{name: value})
            if not 0 <= float(value) <= greatest:  # type: ignore[arg-type]
                bound = "a number from 0 to 1" if greatest == 1 else "a number of at least 0"
                raise ValueError(f"{name}: found {value!r}, expected {bound}")
        self.gap, self.slide, self.slide_row = gap, slide, slide_row
        self.restitution, self.friction = restitution, friction
        self.reach, self.distance = reach, distance


class MechanicalSystem(System):
    """A mechanical system with unilateral contacts: M(q) dv/dt = h(t, q, v, u) + contact forces, dq/dt = v, gaps >= 0.

    Which contacts are closed, stick or slide, the impulses of impacts, detachment and the changes between sticking and
    sliding are found. SI units, or any others; metric and sign of a sliding velocity are those of `Contact`.

    coordinates, controls, parameters: names. The states are the coordinates and their rates, "th" and "dth".
    mass: a function of some of q and p that returns M, (n, n), symmetric and positive definite.
    force: a function of some of t, q, v, u and p that returns h, (n,): all forces but those of contacts, minus the terms
    of M dv/dt that are quadratic in v. Mass and force must be smooth along a motion.
    contacts: a saltus.Contact for each name.
    impact_law: "newton" or "poisson", both with Coulomb's law. rest_speed: bounces accumulate; a contact whose next bounce
    would begin with less than this speed, in units of the gap per time, closes; None: 1e-5.
    draw: as of a HybridSystem; the function may also read q and v.

    A mode is a text with one letter for each contact: "o" open, "n" closed without friction, "+" or "-" closed and sliding
    with this sign of the velocity, "s" sticking. Events of a contact named tip: "hit tip", "off tip", "stop tip",
    "break- tip", "break+ tip", "end tip", "jam tip", "grip tip".

        >>> arm = saltus.MechanicalSystem(
        ...     coordinates=["x", "y"], parameters=["m", "g", "e", "mu"],
        ...     mass=lambda p: [[p[0], 0], [0, p[0]]],
        ...     force=lambda p: [0, -p[0] * p[1]],
        ...     contacts={"ground": saltus.Contact(
        ...         gap=lambda q: q[1], slide=lambda q: q[0], restitution="e", friction="mu")})

    The functions are recorded as those of a `HybridSystem`, and get their arguments by name, or in the orders (q, p) and
    (t, q, v, u, p). C++ evaluates the record and its derivatives of up to the third order; no Python runs then.

    Raises TypeError where a function branches on a value, ValueError where sizes or names do not match or a mass is not
    symmetric, RuntimeError for what a function raises; each names the function.
    """

    _attributes = ("coordinates", "states", "controls", "parameters", "contacts", "impact_law", "rest_speed", "draw")

    def __init__(
        self,
        *,
        coordinates: Sequence[str],
        mass: Callable[..., Any],
        force: Callable[..., Any],
        contacts: Mapping[str, Contact] | None = None,
        controls: Sequence[str] = (),
        parameters: Sequence[str] = (),
        impact_law: str = "newton",
        rest_speed: float | None = None,
        draw: Callable[..., Any] | None = None,
    ):
        expect("a callable", draw=draw)
        self.draw = draw
        if impact_law not in _LAWS:
            raise ValueError(f"impact_law: found {impact_law!r}, expected 'newton' or 'poisson'")
        if rest_speed is not None:
            expect("a number", rest_speed=rest_speed)
            if not 0 <= rest_speed < np.inf:
                raise ValueError(f"rest_speed: found {rest_speed!r}, expected a finite number of at least 0")
        self.impact_law = impact_law
        self.rest_speed = _REST_SPEED if rest_speed is None else float(rest_speed)
        self.coordinates = _names("coordinates", coordinates)
        if not self.coordinates:
            raise ValueError("coordinates: found none, expected at least one")
        self.states = [*self.coordinates, *("d" + name for name in self.coordinates)]
        if len(set(self.states)) < len(self.states):
            raise ValueError("coordinates: found a name that is the name of the rate of another, such as 'x' and 'dx'")
        self.controls = _names("controls", controls)
        self.parameters = _names("parameters", parameters)
        given = _named("contacts", contacts or {})
        self.contacts = _names("contacts", given)
        restitutions = {contact.restitution: (0.0, 1.0) for contact in given.values() if isinstance(contact, Contact)
                        and isinstance(contact.restitution, str)}
        frictions = {contact.friction: (0.0, np.inf) for contact in given.values() if isinstance(contact, Contact)
                     and isinstance(contact.friction, str)}
        self._ranges = {**frictions, **restitutions}
        n = len(self.coordinates)
        self._record = (
            self._of_positions("mass", mass, (n, n)),
            self._record_force(force),
            [self._record_contact(name, contact) for name, contact in given.items()],
        )
        self._system = self._make()

    def _make(self) -> Any:
        names = (self.coordinates, self.controls, self.parameters, self.contacts)
        return _saltus.MechanicalSystem(*self._record, *names, self.impact_law == "poisson", self.rest_speed)

    def _shaped(self, what: str, tape: Tape, values: Any, shape: tuple[int, ...]) -> Any:
        found = np.shape(_as_array(values))
        if values is not None and found != shape and (shape or found != (1,)):
            raise ValueError(f"{what}: found values of shape {found}, expected {shape or 'a number'}")
        return _outputs(what, tape, values)

    def _of_positions(self, what: str, function: Any, shape: tuple[int, ...]) -> Any:
        """Records a function of q and p."""
        tape, n = Tape(), len(self.coordinates)
        symbols = {"q": tape.inputs(0, n), "p": tape.inputs(n, len(self.parameters))}
        reason = f"{what.split(': ')[-1]} is a function of q and p"
        values = _call(what, function, symbols, "qp", {name: reason for name in "tvux"})
        return self._shaped(what, tape, values, shape)

    def _record_force(self, function: Any) -> Any:
        tape, n, parameters = Tape(), len(self.coordinates), len(self.parameters)
        symbols = {"q": tape.inputs(0, n), "v": tape.inputs(n, n), "t": tape.inputs(2 * n, 1)[0],
                   "p": tape.inputs(2 * n + 1, parameters),
                   "u": tape.inputs(2 * n + 1 + parameters, len(self.controls))}
        return self._shaped("force", tape, _call("force", function, symbols, "tqvup"), (n,))

    def _record_contact(self, name: str, contact: Any) -> Any:
        what = f"contact '{name}'"
        if not isinstance(contact, Contact):
            raise TypeError(f"{what}: found {type(contact).__name__}, expected a saltus.Contact")
        n = len(self.coordinates)
        optional = [
            None if function is None else self._of_positions(f"{what}: {part}", function, shape)
            for part, function, shape in (("slide", contact.slide, ()), ("slide_row", contact.slide_row, (n,)),
                                          ("reach", contact.reach, ()), ("distance", contact.distance, ()))
        ]
        return (
            self._of_positions(f"{what}: gap", contact.gap, ()),
            self._coefficient(f"{what}: restitution", contact.restitution),
            self._coefficient(f"{what}: friction", 0.0 if contact.friction is None else contact.friction),
            *optional,
        )

    def _coefficient(self, what: str, value: Any) -> Any:
        tape = Tape()
        p = tape.inputs(0, len(self.parameters))
        if isinstance(value, str):
            if value not in self.parameters:
                expected = ", ".join(self.parameters) or "a number, as there are no parameters"
                raise ValueError(f"{what}: found parameter {value!r}, expected some of {expected}")
            value = p[self.parameters.index(value)]
        elif callable(value):
            value = _call(what, value, {"p": p}, "p")
        return self._shaped(what, tape, value, ())

    def _drawn(self, mode: str, t: float, x: Any) -> dict[str, Any]:
        n = len(self.coordinates)
        return {"mode": mode, "t": t, "x": x, "q": x[:n], "v": x[n:]}

    def _mode_number(self, mode: str | None) -> int:
        if mode is None:
            return -1
        if not isinstance(mode, str):
            raise ValueError(f"mode: found {mode!r}, expected a letter for each of {len(self.contacts)} contacts, such as "
                             f"{'o' * len(self.contacts)!r}; leave it out to have it found")
        return self._system.mode(mode)

    def _states_of(self, mode: str | None) -> list[str]:
        return self.states

    def _guards_of(self, mode: str) -> list[str]:
        return self._system.guards(self._system.mode(mode))

    def _all_guards(self) -> list[str]:
        return [f"{what} {contact}" for contact in self.contacts for what in _EVENTS]

    def _size_after(self, mode: str, guard: str) -> int:
        return len(self.states)

    def _state_sizes(self) -> set[int]:
        return {len(self.states)}

    def _modes_after(self, mode: str, guard: str, parameters: Any) -> list[str]:
        return self._system.next_modes(self._system.mode(mode), self._guards_of(mode).index(guard), parameters)

    def __repr__(self) -> str:
        return (f"<saltus.MechanicalSystem of coordinates {self.coordinates}; contacts {self.contacts}, "
                f"controls {self.controls}, parameters {self.parameters}>")


class _Bodies(MechanicalSystem):
    """The system of a file of bodies, which has its functions in C++. It is pickled by the text of the file."""

    def __init__(self, text: str | bytes, name: str):
        self._text, self._name = text, name
        self._system = self._make()
        read = self._read
        self.coordinates, self.controls = read["coordinates"], read["controls"]
        self.parameters, self.contacts = read["parameters"], read["contacts"]
        self.states = [*self.coordinates, *("d" + name for name in self.coordinates)]
        self.impact_law, self.rest_speed = _LAWS[0], _REST_SPEED

    def _make(self) -> Any:
        self._read = _saltus.read_bodies(self._text, self._name)

        def draw(t: float, x: Any) -> Any:
            lines, circles = self._read["draw"](t, x)
            return [*lines, *circles]

        self.draw = draw
        return self._read["system"]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in super().__getstate__().items() if name != "_read"}


def load_bodies(source: str | os.PathLike[str] | Mapping[str, Any]) -> HybridProblem:
    """Reads the problem of a file of planar bodies (polygons, boxes, discs, joints), as the program saltus_bodies does.

    Returns a HybridProblem with the system, the motion, the objective, and what the file optimizes with its bounds, which
    ``solve`` takes unless it is given others. docs/reference/box-files.md lists the keys.

    Args:
        source: the path of a YAML file, or a dict with its keys.

    Raises:
        SceneError: the file is wrong; it names file, line, key and what was expected.
        OSError: the file cannot be read.
    """
    if isinstance(source, Mapping):
        bodies = _Bodies(json.dumps(dict(source), default=_plain, ensure_ascii=False), "scene")
    else:
        path = expect_path("load_bodies", source, ", or a dict with the keys of one")
        with open(path, "rb") as file:
            bodies = _Bodies(file.read(), path)
    return problem_of(bodies)
