"""Many points of some options, on all cores or on the workers of a cluster."""

from __future__ import annotations

import inspect
import itertools
import numbers
import os
import time
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout  # in Python 3.11 and later the TimeoutError of all
from functools import lru_cache, partial
from typing import Any, Callable, Mapping, Sequence, Union

import numpy as np

from . import _saltus
from ._progress import Progress
from ._scene import Scene, SceneLike, as_scene
from ._types import expect, expect_int, expect_names

_LAST = ("reason", "status")  # columns that every table has
Grid = Union[str, Mapping[Any, Sequence[Any]]]


def _text(value: Any) -> str:
    if not isinstance(value, str) and (isinstance(value, (bool, np.bool_)) or not isinstance(value, (numbers.Real, np.ndarray))):
        raise TypeError(f"grid: found {value!r}, expected numbers or text as the values of an option of a scene")
    return value if isinstance(value, str) else repr(float(value))


def _spec(grid: Grid) -> str:
    """Returns a grid as the text of saltus_sweep --sweep."""
    if isinstance(grid, str):
        return grid
    blocks = []
    for name, values in grid.items():
        if isinstance(name, tuple):
            rows = ",".join("(" + ",".join(map(_text, row)) + ")" for row in values)
            blocks.append(f"({','.join(name)})={rows}")
        else:
            blocks.append(f"{name}={','.join(map(_text, values))}")
    return "; ".join(blocks)


def _names(grid: Mapping[Any, Sequence[Any]]) -> list[Any]:
    """Returns the options of a grid."""
    return [name for key in grid for name in (key if isinstance(key, tuple) else (key,))]


def _checked_grid(grid: Any) -> Mapping[Any, Sequence[Any]]:
    """Returns a grid with lists of its values; raises if it is no dict of the values of each option."""
    if not isinstance(grid, Mapping):
        raise TypeError(f"grid: found {type(grid).__name__}, expected a dict of the values of each option, such as {{'a': [1, 2]}}")
    if not grid:
        raise ValueError("grid: found no option, expected a dict of the values of each option, such as {'a': [1, 2]}")
    lists = {}
    for name, values in grid.items():
        names = name if isinstance(name, tuple) else (name,)
        if not names or not all(isinstance(one, str) for one in names):
            raise TypeError(f"grid: found the option {name!r}, expected a name or a tuple of names")
        if isinstance(values, str) or not np.iterable(values):
            raise TypeError(f"grid: found {values!r} for the option {name!r}, expected a list of its values")
        lists[name] = list(values)
        if isinstance(name, tuple) and any(isinstance(row, str) or not np.iterable(row) for row in lists[name]):
            raise TypeError(f"grid: found {values!r} for the options {', '.join(name)}, expected a list of tuples of their values")
    return lists


def _points(grid: Mapping[Any, Sequence[Any]]) -> list[dict[str, Any]]:
    """Returns every combination of the values of a grid, the last option fastest."""
    blocks = []
    for name, values in grid.items():
        names = name if isinstance(name, tuple) else (name,)
        rows = values if isinstance(name, tuple) else [(value,) for value in values]
        for row in rows:
            if len(row) != len(names):
                raise ValueError(f"grid: found {row!r} for the options {', '.join(names)}, expected {len(names)} values")
        blocks.append([dict(zip(names, row)) for row in rows])
    return [{key: value for block in blocks_of_point for key, value in block.items()} for blocks_of_point in itertools.product(*blocks)]


@lru_cache(maxsize=4)
def _cached_study(key: tuple[Any, ...]) -> _saltus.SweepStudy:
    text, *arguments = key
    return _saltus.SweepStudy(Scene._of_text(text, "scene"), *arguments)


def _scene_row(key: tuple[Any, ...], seconds: float, index: int) -> dict[str, Any]:
    """Computes a point in another process, which keeps the study for the next one."""
    return _cached_study(key).point(index, seconds)


def _called_row(problem: Callable[..., Mapping[str, Any]], values: dict[str, Any]) -> dict[str, Any]:
    result = problem(**values)
    if not isinstance(result, Mapping):
        raise TypeError(f"the function returned {type(result).__name__}, expected a dict of numbers and text by their names")
    for name, value in result.items():
        if name in values or name in _LAST:
            what = "an option of the grid" if name in values else "a column that every table has"
            raise ValueError(f"the function returned {name!r}, which is {what}; return it by another name")
        if np.ndim(value) or not isinstance(value, (str, numbers.Real, np.bool_, np.ndarray, type(None))):
            raise TypeError(f"the function returned {type(value).__name__} as {name!r}, expected a number, text or None")
        _check_number(f"the number {name!r} that the function returned", value)
    return {**values, **result, "reason": "", "status": "done"}


def _check_number(what: str, value: Any) -> None:
    """Raises if a value is a number beyond those of the table's columns."""
    try:
        if value is not None and not isinstance(value, str):
            float(value)
    except OverflowError:
        raise ValueError(f"{what} is beyond the largest float, {np.finfo(float).max:.3g}") from None


def _check_function(problem: Callable[..., Any], grid: Grid, for_scenes: Mapping[str, bool]) -> None:
    """Raises if a function cannot be called with the options of the grid, or if what only scenes take is given."""
    if isinstance(grid, str):
        raise ValueError("grid: found text, expected a dict of the values of each argument of the function")
    for point in _points(grid):
        for name, value in point.items():
            if isinstance(value, numbers.Real):
                _check_number(f"grid: a value of {name!r}", value)
    given = [name for name, is_given in for_scenes.items() if is_given]
    if given:
        raise ValueError(f"{given[0]}: expected with a scene only; give it to the function as an option of the grid")
    names = _names(grid)
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"grid: found {name!r} twice, expected each option once")
    for name in _LAST:
        if name in names:
            raise ValueError(f"grid: found {name!r}, which is a column that every table has; give the option another name")
    try:
        signature = inspect.signature(problem)
    except ValueError:  # of a function in C without one
        return
    try:
        signature.bind(**dict.fromkeys(names))
    except TypeError as error:
        raise TypeError(f"problem: {error}; the function takes {signature}, and the grid has {', '.join(names)}") from None


def _failed_call(values: dict[str, Any], reason: str) -> dict[str, Any]:
    return {**values, "reason": reason, "status": "failed"}


def _column(values: list[Any]) -> np.ndarray[Any, Any]:
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else value for value in values], dtype=str)
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def sweep(
    problem: SceneLike | Callable[..., Mapping[str, Any]],
    grid: Grid,
    client: Any = None,
    *,
    contact: str | Sequence[str] = "event",
    solver: str | Sequence[str] | None = None,
    precision: str = "double",
    iterations: int = 1000,
    learning_rate: float | None = None,
    point_seconds: float = 0,
    threads: int = 0,
    seconds: float = 0,
    progress: bool | None = None,
) -> dict[str, np.ndarray[Any, Any]]:
    """Computes every point of a grid, and returns the columns of the table by their names.

    Of a scene, rows and columns are those of saltus_sweep. Without a solver a row has the loss at the initial guess and
    the error of its gradient. A point that is impossible, raises or takes too long is a row with its ``reason`` and the
    ``status`` "failed". Ctrl-C raises KeyboardInterrupt, which has the table of the points computed until then as its
    attribute ``table``.

    Args:
        problem: a Scene, a dict or the path of a scene file; or a function that is called with the options of a point as
            keyword arguments, and returns a dict of numbers and text by names that are no options of the grid. It takes
            no argument that is for a scene: contact, solver, precision, iterations, learning_rate and point_seconds.
        grid: values of each option, such as ``{"stiffness": [1e3, 1e4], "steps": [120, 240]}``: every combination, the
            last option fastest. A tuple of names has a list of tuples. Of a scene also the text of ``--sweep``.
        client: where the points are computed: a ``distributed.Client`` of Dask, whose scheduler computes the points of a
            worker that dies again, or any other executor with ``submit``. Default: threads of this process.
        contact: names of contact models.
        solver: names of solvers.
        precision: arithmetic of the contact model, "double" or "float".
        iterations: largest number of iterations of a solver.
        learning_rate: step size of gradient descent; default: that of the published experiment.
        point_seconds: time limit of a point of a scene, s; 0 is no limit.
        threads: number of threads without a client; 0 is one per core.
        seconds: limit of time, s, after which points that are not computed yet are rows with the status "failed"; 0 is no
            limit. A call of a function that has begun is not ended.
        progress: whether a line on stderr shows the progress after two seconds; default: on terminals and in notebooks.

    Raises:
        ValueError: an argument or an option is wrong.
        TypeError: the function does not take the options of the grid.
    """
    expect_int(threads=threads, iterations=iterations)
    expect("a number", seconds=seconds, point_seconds=point_seconds, learning_rate=0 if learning_rate is None else learning_rate)
    expect("text", precision=precision)
    if not 0 <= seconds < np.inf:
        raise ValueError(f"seconds: found {seconds:g}, expected a finite number of at least 0; 0 is no limit")
    if threads < 0:
        raise ValueError(f"threads: found {threads}, expected at least 0 (0 is one per core)")
    study = None
    inputs: Sequence[Any]
    if not isinstance(grid, str):
        grid = _checked_grid(grid)
    failed: Callable[[Any, str], dict[str, Any]]
    if callable(problem):
        _check_function(
            problem,
            grid,
            {
                "contact": contact != "event",
                "solver": solver is not None,
                "precision": precision != "double",
                "iterations": iterations != 1000,
                "learning_rate": learning_rate is not None,
                "point_seconds": point_seconds != 0,
            },
        )
        inputs, task, failed = _points(grid), partial(_called_row, problem), _failed_call
    else:
        scene = as_scene(problem)
        contacts = tuple(expect_names(contact=contact))
        solvers = () if solver is None else tuple(expect_names(solver=solver))
        arguments = (_spec(grid), contacts, solvers, precision, iterations, learning_rate)
        study = _saltus.SweepStudy(scene, *arguments)
        inputs, failed = range(len(study)), study.failed
        if client is None:
            task = partial(_local_row, study, point_seconds)
        else:
            task = partial(_scene_row, (scene.to_yaml(), *arguments), point_seconds)
    executor = ThreadPoolExecutor(threads or os.cpu_count()) if client is None else client
    rows: list[dict[str, Any]] = []
    end = time.monotonic() + seconds if seconds else None
    names = None if isinstance(grid, str) else _names(grid)
    try:
        with Progress("sweep", progress, len(inputs)) as shown:
            futures = [executor.submit(task, value) for value in inputs]
            for value, future in zip(inputs, futures):
                rows.append(_row_of(future, end, seconds, partial(failed, value)))
                shown.advance(len(rows))
    except BaseException as error:
        error.table = _table(rows, names)  # type: ignore[attr-defined]
        raise
    finally:
        if client is None:
            if study is not None:
                study.stop()
            executor.shutdown(cancel_futures=True)
    return _table(rows, names)


def _row_of(future: Any, end: float | None, seconds: float, failed: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
    """Returns the row of a point; one that failed, if it is not computed at the end of the time."""
    late = f"the point was not computed within {seconds:g} s, the limit of the sweep; raise seconds"
    try:
        error = future.exception(None if end is None else max(1e-3, end - time.monotonic()))
    except (TimeoutError, FutureTimeout):
        future.cancel()
        return failed(late)
    if error is not None and not isinstance(error, Exception):
        raise error  # such as KeyboardInterrupt
    return future.result() if error is None else failed(f"{type(error).__name__}: {error}")


def _table(rows: list[dict[str, Any]], names: list[str] | None) -> dict[str, np.ndarray[Any, Any]]:
    """Returns the columns of rows; those of `names`, if there are none."""
    found = [name for row in rows for name in row] if rows else names or []
    columns = [name for name in dict.fromkeys(found) if name not in _LAST]
    return {name: _column([row.get(name) for row in rows]) for name in (*columns, *_LAST)}


def _local_row(study: _saltus.SweepStudy, seconds: float, index: int) -> dict[str, Any]:
    return study.point(index, seconds)
