"""Results: the keys of the programs' JSON, with numbers as numpy arrays."""

from __future__ import annotations

import html
import json
import os
from typing import Any, Callable, Iterator, Mapping

import numpy as np

from ._types import Floats, expect_path


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Result):
        return value.to_dict()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def number_array(value: Any) -> Any:
    """Returns lists of numbers as an array, with null as NaN, and everything else unchanged."""
    if not isinstance(value, list) or not value:
        return value
    first = value
    while isinstance(first, list):
        if not first:
            return value
        first = first[0]
    if isinstance(first, bool) or not (first is None or isinstance(first, (int, float))):
        return value
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        return _with_torques(value)


def _with_torques(value: Any) -> Any:
    """Returns a control of which some discs have a torque as (K, C, 3), with 0 for the others, and anything else unchanged."""
    try:
        rows = [[row + [0.0] * (3 - len(row)) for row in interval] for interval in value]
        known = all(len(row) in (2, 3) for interval in value for row in interval)
        return np.array(rows, dtype=float) if known else value
    except (TypeError, ValueError):
        return value


class Control(np.ndarray):
    """The control of a run whose intervals are not equally long, or whose duration was free: an array with the lengths of
    its intervals as ``durations``, s. What takes a control on equal intervals refuses it. Copies and arrays that are computed
    from it have its durations if they have as many intervals; ``np.array(control)`` is an array without them."""

    durations: Floats | None

    def __array_finalize__(self, of: Any) -> None:
        durations = getattr(of, "durations", None)
        is_whole = durations is not None and self.shape[:1] == (len(durations),)
        self.durations = durations if is_whole else None

    def __reduce__(self) -> Any:
        return on_intervals, (np.array(self), self.durations)

    def __copy__(self) -> Control:
        return on_intervals(np.array(self), self.durations)

    def __deepcopy__(self, memo: dict[int, Any]) -> Control:
        return self.__copy__()


def on_intervals(control: Any, durations: Any) -> Control:
    """Returns a control as an array with the lengths of its intervals, if there are any."""
    array = np.asarray(control, dtype=float).view(Control)
    array.durations = None if durations is None else np.array(durations, dtype=float)
    return array


class Result(Mapping[str, Any]):
    """A mapping with the keys of the programs' JSON.

    ``result["control"]`` is the value in the JSON document (lists, numbers, text). ``result.control`` is the same, with
    lists of numbers as arrays and objects as results. ``save(path)`` writes JSON from which ``load_result(path)`` reads
    the same bits.
    """

    _kind = "result"

    def __init__(self, data: Mapping[str, Any]):
        self._data = dict(data)

    def __getitem__(self, key: str) -> Any:
        return self._data[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._data)

    def __len__(self) -> int:
        return len(self._data)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._data:
            raise AttributeError(f"this {self._kind} has no {name!r}; it has {', '.join(self._data)}")
        value = self._data[name]
        return Result(value) if isinstance(value, dict) else number_array(value)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._data]

    def __reduce__(self) -> Any:
        return (type(self), (self._data,))

    def to_dict(self) -> dict[str, Any]:
        """Returns plain dicts, lists, numbers and text, as in the programs' JSON."""
        plain: dict[str, Any] = json.loads(json.dumps(self._data, default=_plain))
        return plain

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes JSON with all digits to a file."""
        with open(path, "w", encoding="utf-8") as file:
            json.dump({"saltus": self._kind, **self.to_dict()}, file, indent=1)
            file.write("\n")

    def _rows(self) -> list[tuple[str, str]]:
        """Returns the rows that `repr` shows, without those that are empty."""
        return [(key, text) for key, text in ((key, _brief(value)) for key, value in self._data.items()) if text]

    def __repr__(self) -> str:
        rows = self._rows()
        width = max((len(key) for key, _ in rows), default=0)
        return "\n".join([f"<saltus {self._kind}>", *(f"  {key:<{width}}  {text}" for key, text in rows)])

    def _repr_html_(self) -> str:
        cells = "".join(
            f"<tr><th style='text-align:left'>{html.escape(key)}</th>"
            f"<td style='text-align:left'>{html.escape(text)}</td></tr>"
            for key, text in self._rows()
        )
        return f"<table><caption>saltus {html.escape(self._kind)}</caption>{cells}</table>"


def _brief(value: Any) -> str:
    """Returns one line for a value of any size; empty for an empty list or text."""
    value = number_array(value)
    if isinstance(value, np.ndarray):
        return f"array {value.shape}" if value.size > 6 else np.array2string(value, precision=10, separator=", ").replace("\n", "")
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        if "verdict" in value:
            return str(value["verdict"])
        return "{" + ", ".join(f"{key}: {_brief(part)}" if isinstance(part, (str, float)) else key for key, part in value.items()) + "}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_brief, value))})"
    if not isinstance(value, list):
        return str(value)
    if len(value) > 0 and isinstance(value[0], Mapping):
        if set(value[0]) == {"kind", "text"}:
            return "; ".join(remark["text"] for remark in value)
        return f"{len(value)} of {{{', '.join(value[0])}}}"
    if len(value) > 3:
        shape = f" {value[0].shape}" if isinstance(value[0], np.ndarray) else ""
        return f"{len(value)} {'arrays' if shape else 'entries'}, the first{shape or ' ' + _brief(value[0])}"
    return ", ".join(map(_brief, value))


class Rollout(Result):
    """A motion: ``states`` (K + 1, B, 4) with [p_x p_y v_x v_y] of each disc, ``times`` (K + 1) in s, ``loss``,
    ``events``, ``steps_with_contact``, ``remarks``. In scenes with rotational inertia states are (K + 1, B, 6), with the angle in rad
    and the angular velocity in rad/s at the end; models that rotate discs in other scenes add their own numbers."""

    _kind = "rollout"

    @property
    def _states(self) -> Floats:
        return np.asarray(self._data["states"])

    @property
    def positions(self) -> Floats:
        """The positions, (K + 1, B, 2), m."""
        return self._states[..., :2]

    @property
    def velocities(self) -> Floats:
        """The velocities, (K + 1, B, 2), m/s."""
        return self._states[..., 2:4]

    @property
    def final_state(self) -> Floats:
        """The last of ``states``, (B, 4 or more)."""
        return np.asarray(self._states[-1])


class Gradient(Result):
    """A loss and its gradient: ``gradient.position``, ``.velocity`` (B, 2), ``.control`` (K, C, 2), ``.parameters``, and in
    scenes with rotational inertia ``.angle`` and ``.angular_velocity`` (B,); and ``remarks``."""

    _kind = "gradient"


class _OfScene(Result):
    """A result of a scene that has a page."""

    _page: Callable[[str], None] | None = None

    def save_page(self, folder: str | os.PathLike[str]) -> None:
        """Writes the page that programs write, ``report.html``, and its numbers, ``result.json``, to a folder, which is made if
        there is none; of a run also its motion and control, an NPZ file.

        Raises:
            ValueError: this result was read from a file or a pickle, or is of a contact model in Python; such have no page.
            OSError: the folder cannot be made.
        """
        if self._page is None:
            raise ValueError(
                f"save_page: found a {self._kind} without its scene, from a file, a pickle or a contact model in Python; expected one that "
                "solve or identify has returned for a built-in contact model"
            )
        os.makedirs(folder, exist_ok=True)
        self._page(os.fspath(folder))
        self.save(os.path.join(folder, "result.json"))


class Run(_OfScene):
    """A run of a solver: ``termination``, ``final_loss`` under its contact model, ``exact_loss`` under exact dynamics,
    ``losses``, ``control`` (K, C, 2) in N, ``velocity`` (B, 2) in m/s, ``events``, ``certificate``, ``remarks``, ... If the control's
    intervals are not those of the scene, ``durations`` (K,) has their lengths, s."""

    _kind = "run"

    @property
    def control(self) -> Any:
        """The control, (K, C, 2) in N, or (K, C, 3) with torques in N m."""
        control = self.__getattr__("control")
        return on_intervals(control, self._data["durations"]) if self._data.get("durations") else control

    @property
    def converged(self) -> bool:
        return bool(self._data["termination"] == "converged")

    @property
    def reason(self) -> str:
        """The reason for its end, or a remark; empty if there is none."""
        return str(self._data.get("reason", ""))


class Audit(Result):
    """Gradients of contact models beside the exact one: ``reference`` (if there is one) and ``audits``, one for each
    model, with ``verdict``, ``relative_error``, ``class``, ``why``, ..."""

    _kind = "audit"

    def of(self, contact: str) -> Result:
        """Returns the audit of one model. Raises KeyError if it was not audited."""
        for item in self._data["audits"]:
            if item["contact"] == contact:
                return Result(item)
        raise KeyError(f"{contact!r}; audited were {', '.join(item['contact'] for item in self._data['audits'])}")

    @property
    def verdicts(self) -> dict[str, str]:
        """The verdict on each model, or why there is none."""
        return {item["contact"]: item.get("verdict", item.get("termination", "")) for item in self._data["audits"]}

    def raise_if_wrong(self, accept: tuple[str, ...] = ("right", "consistent")) -> None:
        """Raises WrongGradient unless every verdict is one of `accept`: for test suites."""
        wrong = [item for item in self._data["audits"] if item.get("verdict") not in accept]
        if not wrong and "interrupted" in self._data:
            raise WrongGradient(f"the audit was interrupted before all were judged: {self._data.get('reason', '')}")
        if wrong:
            raise WrongGradient("; ".join(_why_wrong(item) for item in wrong))

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("scene", f"{self._data['scene']}, {self._data['steps']} steps, {self._data['precision']}")]
        for item in self._data["audits"]:
            error = f", relative error {item['relative_error']:.3g}" if item.get("relative_error") is not None else ""
            rows.append((item["contact"], f"{item.get('verdict', item.get('termination', ''))}{error}{_why(item)}"))
            rows += [("remark", finding) for finding in item.get("findings", [])]
        return rows + [("interrupted", self._data.get("reason", ""))] if "interrupted" in self._data else rows


def _why(item: Mapping[str, Any]) -> str:
    """The class of a model and the reasons of its verdict, after a colon; empty without any. Where a simulator's derivative
    contradicts its own motion, the class of its contact comes last."""
    reasons = [item.get("class"), item.get("why") or item.get("reason")]
    if item.get("own_gradient") and item.get("agrees_with_differences") is False:
        reasons.reverse()
    text = "; ".join(reason for reason in reasons if reason)
    return f": {text}" if text else ""


def _why_wrong(item: Mapping[str, Any]) -> str:
    verdict = item.get("verdict", item.get("termination", "not judged"))
    found = "has the wrong sign" if verdict == "wrong sign" else f"is {verdict}"
    return f"{item['contact']}: the gradient {found}{_why(item)}"


class Fit(_OfScene):
    """Parameters fitted to recordings: ``verdict`` ("fits", "contradicted", ...), ``parameters`` with ``value``,
    ``standard_error``, ``interval`` (95 % confidence) and ``determination``, ``misfit``, ``outliers``, ``segments``, ``law``
    and ``events`` if they were fitted, ... A fit of hybrid problems has ``sigma`` of each quantity by its name, if it was
    estimated, and the number of ``events``."""

    _kind = "fit"
    _problems: list[Any] | None = None

    @property
    def problems(self) -> list[Any]:
        """Of hybrid problems: copies with the fitted values; what is not determined is as it was."""
        if self._problems is None:
            raise AttributeError("this fit has no problems: it is of a scene, or was read from a file or a pickle")
        return self._problems

    @property
    def reason(self) -> str:
        """Reason of the verdict; empty if the model fits."""
        return str(self._data.get("reason", ""))

    @property
    def remarks(self) -> list[str]:
        """What else the residuals tell; empty if nothing."""
        return list(self._data.get("remarks", []))

    @property
    def estimates(self) -> dict[str, float]:
        """The value of each parameter, by name; NaN where the recordings do not determine it."""
        return {item["name"]: float("nan") if item["value"] is None else item["value"] for item in self._parameters}

    @property
    def _parameters(self) -> list[dict[str, Any]]:
        return list(self._data.get("parameters", []))

    def _rows(self) -> list[tuple[str, str]]:
        reason = self._data.get("reason")
        by = "contact" if "contact" in self._data else "system"
        rows = [(by, self._data[by]), ("verdict", self._data["verdict"] + (f": {reason}" if reason else ""))]
        for item in self._parameters:
            if item["standard_error"] is None:
                with_others = f" with {', '.join(item['with'])}" if "with" in item else ""
                at = f"{item['value']:.7g}, " if item["value"] is not None else ""
                rows.append((item["name"], at + item["determination"] + with_others))
            else:
                low, high = item["interval"]
                rows.append((item["name"], f"{item['value']:.7g} +- {item['standard_error']:.3g}, {low:.6g} to {high:.6g}"))
        keys = ("misfit", "sigma", "samples", "impacts" if by == "contact" else "events", "seconds")
        rows += [(key, _brief(self._data[key])) for key in keys if key in self._data]
        if self._data.get("outliers"):
            rows.append(("outliers", str(len(self._data["outliers"]))))
        rows += [("remark", remark) for remark in self._data.get("remarks", [])]
        return rows


class WrongGradient(AssertionError):
    """Raised for a gradient that is not right, with the reasons of the audit."""


# By what load_result makes of a file.
KINDS: dict[str, type[Result]] = {kind._kind: kind for kind in (Rollout, Gradient, Run, Audit, Fit)}


def load_result(path: str | os.PathLike[str]) -> Result:
    """Reads a result that ``Result.save`` has written. Raises ValueError if the file is something else."""
    with open(expect_path("load_result", path), "rb") as file:
        content = file.read()
    if content.startswith(b"PK"):
        raise ValueError(f"{os.fspath(path)}: found an NPZ archive, such as programs write; read it with numpy.load")
    try:
        data = json.loads(content)
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: expected a result that saltus has saved, in JSON: {error}") from error
    if not isinstance(data, dict) or "saltus" not in data:
        raise ValueError(f"{os.fspath(path)}: expected a result that saltus has saved")
    kind = KINDS.get(data.pop("saltus"), Result)
    if kind is Rollout:
        data = {key: np.array(value) if key in ("states", "times", "steps_with_contact") else value
                for key, value in data.items()}
    return kind(data)
