"""Parameters of scenes from recordings of their motion."""

from __future__ import annotations

import os
from typing import Any, Callable, Mapping, Sequence, Union

from . import _saltus
from ._results import Fit
from ._scene import SceneLike, as_scene
from ._types import expect

Recording = Union[str, "os.PathLike[str]", Mapping[str, Any]]


def _plain(recording: Any, index: int) -> str | dict[str, Any]:
    if isinstance(recording, (str, os.PathLike)):
        return os.fspath(recording)
    if isinstance(recording, Mapping):
        return dict(recording)
    raise TypeError(
        f"recordings[{index}]: found {type(recording).__name__}, expected the path of a CSV or NPZ file, or a dict of arrays"
    )


def identify(
    scene: SceneLike,
    recordings: Recording | Sequence[Recording],
    unknown: str | Sequence[str] = (),
    contact: str = "event",
    *,
    law: str = "",
    events: str = "",
    loss: str = "huber",
    loss_scale: float = 2,
    segment: float = 0,
    known_start: bool = False,
    starts: int = 12,
    threads: int = 0,
    status: Callable[[str], None] | None = None,
) -> Fit:
    """Fits parameters of a scene to where discs were seen, by least squares through impacts.

    recordings: one, or several that share the parameters, each with its own start. The path of a CSV or NPZ file, or a
    dict of arrays: ``time`` (n,) in s, ``body`` (n,), names or indices, ``position`` (n, 2) in m, and if they are known
    ``velocity`` (n, 2) in m/s and the standard deviations ``sigma`` and ``sigma_v`` (n,), or one number for all.
    unknown: some of restitution, friction, stiffness, damping, gravity, mass.BODY, force.BODY, of vectors one component
    as gravity.y: a list, or a text with commas; restitution if not given, or nothing beside a law or events.
    contact: the built-in contact model that is fitted. law: learns the law of impact: "network" (restitution by the speed
    of approach) or "impulse" (friction too), perhaps with ":N" hidden units. events: learns where and how discs bounce off
    planes: "affine" or "profile", which maybe has ":N" units. loss: of a sample's residual, "none" (squares), "huber" or
    "cauchy", with loss_scale in sigmas. segment: s, cuts recordings into pieces with a start each, as long ones need.
    known_start: starts are the scene's. starts: fits at most. threads: 0 is one per core. status(text): called with what
    is at work.

    Returns the fit, whatever its verdict. Raises ValueError, with the place, for wrong recordings, names and options, and
    if the model cannot take the scene; what the callback raises. Ctrl-C raises KeyboardInterrupt, at once; it, and what
    the callback has raised, has the fit so far as its attribute ``fit``.
    """
    expect("text", law=law, events=events, loss=loss)
    expect("a whole number", starts=starts, threads=threads)
    expect("a number", loss_scale=loss_scale, segment=segment)
    expect("True or False", known_start=known_start)
    expect("a callable", status=status)
    given = [recordings] if isinstance(recordings, (str, os.PathLike, Mapping)) else list(recordings)
    names = unknown if isinstance(unknown, str) else ",".join(unknown)
    found, stopped_by = _saltus.identify(
        as_scene(scene),
        [_plain(recording, index) for index, recording in enumerate(given)],
        names or ("" if law or events else "restitution"),
        contact,
        law=law,
        events=events,
        loss=loss,
        loss_scale=loss_scale,
        segment=segment,
        known_start=known_start,
        starts=starts,
        threads=threads,
        status=status,
    )
    fit = Fit(found)
    if stopped_by is not None:
        stopped_by.fit = fit  # type: ignore[attr-defined]
        raise stopped_by
    return fit
