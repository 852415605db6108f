"""Parameters of scenes from recordings of their motion."""

from __future__ import annotations

import os
from typing import Any, Callable, Iterable, Mapping, Sequence, Union

from . import _saltus
from ._hybrid import HybridProblem
from ._progress import Progress
from ._results import Fit
from ._scene import SceneLike, as_scene
from ._types import expect, expect_int

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
    seconds: float = 0,
    progress: bool | None = None,
) -> Fit:
    """Fits parameters of a scene to recorded positions of its discs, by least squares through impacts.

    Ctrl-C raises KeyboardInterrupt at once. This exception, and one that the callback raises, has the fit computed until
    then as its attribute ``fit``.

    Args:
        scene: a Scene, a dict or the path of a scene file.
        recordings: one recording, or several that share the parameters, each with its own initial state: the path of a CSV
            or NPZ file, or a dict of arrays: ``time`` (n,) in s, ``body`` (n,), names or indices, ``position`` (n, 2) in
            m, and if they are known ``velocity`` (n, 2) in m/s and the standard deviations ``sigma`` and ``sigma_v`` (n,)
            or one number for all.
        unknown: restitution, friction, stiffness, damping, gravity, mass.BODY, force.BODY, or one component of a vector
            such as gravity.y, in a list or a text with commas; in a scene with materials restitution and friction of
            pairs, such as restitution.rubber-steel. Default: restitution, or nothing beside a law or events.
        contact: name of a built-in contact model.
        law: impact law to fit: "network" (restitution as a function of the approach speed) or "impulse" (friction too),
            with ":N" hidden units.
        events: event functions to fit: "affine" or "profile", with ":N" units.
        loss: robust loss of the residual of a sample: "none" (squares), "huber" or "cauchy".
        loss_scale: residual, in standard deviations, beyond which the robust loss reduces the weight.
        segment: length, s, of the segments into which recordings are divided, each with its own initial state; 0: not
            divided.
        known_start: whether the initial state is that of the scene.
        starts: largest number of starts of the fit.
        threads: number of threads; 0 is one per core.
        status: called as status(text) with the progress.
        seconds: limit of time, s, after which the fit ends as "interrupted" with what it has; 0 is no limit.
        progress: whether a line on stderr shows the progress after two seconds; default: on terminals and in notebooks.

    Returns:
        The fit, whatever its verdict.

    Raises:
        ValueError: a recording, a name or an option is wrong, or the model does not support the scene.
    """
    for given_scene in scene if isinstance(scene, (list, tuple)) else [scene]:
        if isinstance(given_scene, HybridProblem):
            raise TypeError("scene: found a HybridProblem, expected a scene; data of a HybridProblem are costs, saltus.measurements and "
                            "saltus.event_times, which saltus.solve(problem, optimize=[...]) fits")
    expect("text", law=law, events=events, loss=loss)
    expect_int(starts=starts, threads=threads)
    expect("a number", loss_scale=loss_scale, segment=segment, seconds=seconds)
    expect("True or False", known_start=known_start)
    expect("a callable", status=status)
    is_list = isinstance(recordings, Iterable) and not isinstance(recordings, (str, os.PathLike, Mapping))
    given = list(recordings) if is_list else [recordings]
    names = unknown if isinstance(unknown, str) else ",".join(unknown)
    with Progress("identify", progress) as shown:
        found, page, stopped_by = _saltus.identify(
            as_scene(scene),
            [_plain(recording, index) for index, recording in enumerate(given)],
            names or ("" if law or events else "restitution"),
            contact,
            law=law,
            events=events,
            loss=loss,
            loss_scale=loss_scale,
            segment=segment,
            seconds=float(seconds),
            known_start=known_start,
            starts=starts,
            threads=threads,
            status=shown.status(status),
        )
    fit = Fit(found)
    fit._page = page
    if stopped_by is not None:
        stopped_by.fit = fit  # type: ignore[attr-defined]
        raise stopped_by
    return fit
