"""Parameters of scenes from recordings of their motion."""

from __future__ import annotations

import copy
import os
from typing import Any, Callable, Iterable, Mapping, Sequence, Union

import numpy as np

from . import _saltus
from ._hybrid import HybridProblem, _check_bounds
from ._mechanical import MechanicalSystem
from ._progress import Progress
from ._results import Fit
from ._scene import SceneLike, as_scene
from ._types import expect, expect_int, expect_names, expect_none_of

Recording = Union[str, "os.PathLike[str]", Mapping[str, Any]]


def _plain(recording: Any, index: int) -> str | dict[str, Any]:
    if isinstance(recording, (str, os.PathLike)):
        return os.fspath(recording)
    if isinstance(recording, Mapping):
        return dict(recording)
    raise TypeError(
        f"recordings[{index}]: found {type(recording).__name__}, expected the path of a CSV or NPZ file, or a dict of arrays"
    )


def _unknowns(problems: list[HybridProblem], parameters: Any, own: Any, bounds: Any) -> list[tuple[str, bool, int, int, float, float]]:
    """The unknowns as C++ has them: name, whether it is of the initial state, index, the only experiment, and bounds."""
    first = problems[0]
    states, names = first.system._states_of(first.mode), first.system.parameters
    listed = []
    for option, given in (("parameters", expect_names(parameters=parameters)), ("own", expect_names(own=own))):
        for name in given:
            if name not in states and name not in names:
                raise ValueError(f"{option}: found {name!r}, expected some of {', '.join([*names, *states])}")
            if name in [known for _, known in listed]:
                raise ValueError(f"{option}: found {name!r} twice, expected it once in parameters and own")
            listed.append((option, name))
    if not listed:
        raise ValueError(f"parameters: found none, expected some of {', '.join([*names, *states])}, or own=")
    for number, problem in enumerate(problems):
        if problem.system._states_of(problem.mode) != states or problem.system.parameters != names:
            raise ValueError(f"problem {number}: found other states or parameters than those of problem 0, expected the same names")
    given_bounds = _check_bounds({} if bounds is None else bounds, {name for _, name in listed})
    unknowns = []
    for option, name in listed:
        experiments = [-1] if option == "parameters" or len(problems) == 1 else range(len(problems))
        for experiment in experiments:
            of = problems[max(experiment, 0)]
            ranges = {**of.system._ranges, **_check_bounds(of.bounds, set(of.bounds)), **given_bounds}
            label = name if experiment < 0 else f"{name}[{experiment}]"
            is_state = name in states
            index = (states if is_state else names).index(name)
            unknowns.append((label, is_state, index, experiment, *ranges.get(name, (-np.inf, np.inf))))
    return unknowns


def _fitted(problems: list[HybridProblem], unknowns: list[Any], estimates: Mapping[str, float]) -> list[HybridProblem]:
    """Copies of the problems with what was determined."""
    fitted = [copy.copy(problem) for problem in problems]
    for label, is_state, index, experiment, *_ in unknowns:
        if np.isnan(estimates.get(label, np.nan)):
            continue
        for problem in fitted if experiment < 0 else [fitted[experiment]]:
            name = "initial" if is_state else "parameters"
            values = np.array(getattr(problem, name), dtype=float)
            values[index] = estimates[label]
            setattr(problem, name, values)
    return fitted


def _identify_hybrid(problems: list[Any], parameters: Any, own: Any, bounds: Any, status: Any, progress: bool | None,
                     **options: Any) -> Fit:
    experiments = []
    for number, problem in enumerate(problems):
        if not isinstance(problem, HybridProblem):
            raise TypeError(f"scene: found {type(problem).__name__} as problem {number}, expected a HybridProblem, as others are")
        data = []
        for cost in problem._costs():
            found = cost._data()
            if found is None:
                raise ValueError(f"problem {number}: found the term '{cost.name}' among its costs, expected data alone: "
                                 "saltus.measurements and saltus.event_times; saltus.solve takes data beside other terms")
            data += found
        if not data:
            raise ValueError(f"problem {number}: found no data among its costs, expected saltus.measurements or saltus.event_times")
        experiments.append((problem, data))
    unknowns = _unknowns(problems, parameters, own, bounds)
    kind = "mechanical system" if isinstance(problems[0].system, MechanicalSystem) else "hybrid system"
    with Progress("identify", progress) as shown:
        found, page, stopped_by = _saltus.identify_hybrid(
            kind,
            [problem._call("experiment", f"problem {number}", data) for number, (problem, data) in enumerate(experiments)],
            unknowns,
            status=shown.status(status),
            **options,
        )
    fit = Fit(found)
    fit._page, fit._problems = page, _fitted(problems, unknowns, fit.estimates)
    if stopped_by is not None:
        stopped_by.fit = fit  # type: ignore[attr-defined]
        raise stopped_by
    return fit


def identify(
    scene: SceneLike | HybridProblem | Sequence[HybridProblem],
    recordings: Recording | Sequence[Recording] | None = None,
    unknown: str | Sequence[str] = (),
    contact: str = "event",
    *,
    parameters: str | Sequence[str] = (),
    own: str | Sequence[str] = (),
    bounds: Mapping[str, Any] | None = None,
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
    """Fits parameters of a scene to recorded positions of its discs, or of hybrid problems to their data, by least squares
    through impacts.

        >>> fit = saltus.identify(scene, "ball.csv", ["restitution", "gravity.y"])
        >>> fit = saltus.identify([first, second], parameters=["e", "g"], own=["y"])

    Data of a HybridProblem are its costs, ``saltus.measurements`` and ``saltus.event_times``; it has no others. Several
    problems are experiments with the same states and parameters.

    Ctrl-C raises KeyboardInterrupt at once. This exception, and one that the callback raises, has the fit computed until
    then as its attribute ``fit``.

    Args:
        scene: a Scene, a dict or the path of a scene file; or one HybridProblem or a list of them, which takes ``parameters``,
            ``own`` and ``bounds`` in place of ``recordings``, ``unknown``, ``contact``, ``law``, ``events``, ``segment`` and
            ``known_start``.
        recordings: one recording, or several that share the parameters, each with its own initial state: the path of a CSV
            or NPZ file, or a dict of arrays: ``time`` (n,) in s, ``body`` (n,), names or indices, ``position`` (n, 2) in
            m, and if they are known ``velocity`` (n, 2) in m/s and the standard deviations ``sigma`` and ``sigma_v`` (n,)
            or one number for all.
        unknown: restitution, friction, stiffness, damping, gravity, mass.BODY, force.BODY, radius.BODY, position.BODY of
            a fixed disc, offset.WALL, angle.WALL, or one component of a vector such as gravity.y, in a list or a text with commas; in a scene with materials restitution and friction of
            pairs, such as restitution.rubber-steel. Default: restitution, or nothing beside a law or events.
        contact: name of a built-in contact model.
        parameters: of hybrid problems, the names of parameters, or of components of the initial state, that all experiments
            have in common and that are fitted from those of the first problem on.
        own: of hybrid problems, the names of those of which each experiment has its own, which the fit calls "y[0]", "y[1]", ...
        bounds: of hybrid problems, pairs (least, greatest) by these names; default: those of the problem, and of a
            MechanicalSystem from 0 to 1 of a parameter that is a restitution and from 0 on of a friction.
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
    expect("text", law=law, events=events, loss=loss)
    expect_int(starts=starts, threads=threads)
    expect("a number", loss_scale=loss_scale, segment=segment, seconds=seconds)
    expect("True or False", known_start=known_start)
    expect("a callable", status=status)
    given_scene: Any = scene
    problems = list(given_scene) if isinstance(given_scene, (list, tuple)) else [given_scene]
    if any(isinstance(problem, HybridProblem) for problem in problems):
        expect_none_of(identify, recordings=recordings, unknown=unknown, contact=contact, law=law, events=events, segment=segment,
                       known_start=known_start)
        return _identify_hybrid(problems, parameters, own, bounds, status, progress, loss=loss, loss_scale=float(loss_scale),
                                seconds=float(seconds), starts=starts, threads=threads)
    if len(parameters) > 0 or len(own) > 0 or bounds is not None:
        raise ValueError("parameters, own and bounds: found some with a scene, expected unknown= with names such as restitution; these "
                         "are of hybrid problems")
    if recordings is None:
        raise TypeError("recordings: found none, expected the path of a CSV or NPZ file, or a dict of arrays")
    is_list = isinstance(recordings, Iterable) and not isinstance(recordings, (str, os.PathLike, Mapping))
    given = list(recordings) if is_list else [recordings]
    names = ",".join(expect_names(unknown=unknown))
    with Progress("identify", progress) as shown:
        found, page, stopped_by = _saltus.identify(
            as_scene(given_scene),
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
