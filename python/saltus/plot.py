"""Figures with matplotlib, in the colours of the report: each function draws into `ax`, or into a new figure, and returns
its axes."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import matplotlib.pyplot as plt  # type: ignore[import]
import numpy as np
from matplotlib.colors import LogNorm, Normalize  # type: ignore[import]

from . import _saltus
from ._results import Audit, Result, Rollout, Run
from ._scene import SceneLike, as_scene


def style(contact: str) -> dict[str, Any]:
    """Returns colour, line and marker of a contact model, as keyword arguments of matplotlib."""
    return _saltus.style(contact)


def _axes(ax: Any, x: str, y: str) -> Any:
    if ax is None:
        _, ax = plt.subplots(layout="constrained")
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def _draw_walls(ax: Any, scene: Mapping[str, Any]) -> None:
    """Draws segments, polygons, arcs and pockets, and the planes within what is shown then."""
    look = {"color": "black", "linewidth": 1}
    for segment in scene.get("segments", []):
        ax.plot(*zip(segment["from"], segment["to"]), **look)
    for polygon in scene.get("polygons", []):
        ax.plot(*zip(*polygon["points"], polygon["points"][0]), **look)
    for arc in scene.get("arcs", []):
        angles = np.linspace(arc["from"], arc["to"], 100)
        ax.plot(*(np.asarray(arc["center"])[:, None] + arc["radius"] * np.array([np.cos(angles), np.sin(angles)])), **look)
    for pocket in scene.get("pockets", []):
        ax.add_patch(plt.Circle(tuple(pocket["position"]), pocket["radius"], fill=False, **look))
    ax.autoscale_view()
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    for plane in scene.get("planes", []):
        normal = np.asarray(plane["normal"], dtype=float)
        point = np.asarray(plane["motion"]["positions"][0] if plane.get("motion") else plane["point"], dtype=float)
        ax.axline(point, point + [normal[1], -normal[0]], **look)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)


def trajectory(scene: SceneLike, motion: Rollout, ax: Any = None) -> Any:
    """Draws the paths of all discs, the discs at the start and the end (a spoke shows the angle of discs with rotational
    inertia), and the walls."""
    data = as_scene(scene).to_dict()
    ax = _axes(ax, "x (m)", "y (m)")
    for body, path in zip(data["bodies"], np.moveaxis(np.asarray(motion["states"]), 1, 0)):
        (line,) = ax.plot(*path[:, :2].T, label=body["name"])
        for state, opacity in ((path[0], 0.15), (path[-1], 0.45)):
            ax.add_patch(plt.Circle(tuple(state[:2]), body["radius"], color=line.get_color(), alpha=opacity))
            if "inertia" in body:
                rim = state[:2] + body["radius"] * np.array([np.cos(state[4]), np.sin(state[4])])
                ax.plot(*zip(state[:2], rim), color=line.get_color(), linewidth=1)
    ax.set_aspect("equal")
    _draw_walls(ax, data)
    ax.legend(frameon=False)
    return ax


def controls(scene: SceneLike, run: Run, ax: Any = None) -> Any:
    """Draws the forces and torques of a solution over time, which are constant over each interval."""
    read = as_scene(scene)
    control = run.control
    lengths = run.durations if "durations" in run else np.full(len(control), read.duration / len(control))
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    ax = _axes(ax, "time (s)", "force (N), torque (N m)" if read.turned else "force (N)")
    for c, body in enumerate(read.controlled):
        components = ["x", "y", "torque"] if body in read.turned else ["x", "y"]
        for j, component in enumerate(components):
            ax.stairs(control[:, c, j], edges, baseline=None, label=f"{body} {component}", linewidth=1.5)
    for event in run["events"]:
        ax.axvline(event["time"], color="black", linewidth=0.8, linestyle="dotted")
    ax.legend(frameon=False)
    return ax


def losses(runs: Run | Sequence[Run], ax: Any = None) -> Any:
    """Draws learning curves: the loss of each iterate, in the style of the contact model."""
    ax = _axes(ax, "iteration", "loss")
    for run in [runs] if isinstance(runs, Run) else runs:
        look = {**style(run["contact"]), "markevery": max(1, len(run["losses"]) // 8)}
        ax.plot(run.losses, label=f"{run['contact']} {run['solver']}", **look)
    beside = {"loc": "upper left", "bbox_to_anchor": (1, 1)} if len(ax.lines) > 5 else {}
    ax.legend(frameon=False, **beside)
    return ax


_VERDICTS = {"right": "#116329", "consistent": "#116329", "wrong": "#a40e26", "wrong sign": "#a40e26"}


def audit(report: Audit, ax: Any = None) -> Any:
    """Draws the relative error of the gradient of every model, with the verdict."""
    judged = [item for item in report["audits"] if item.get("relative_error") is not None]
    ax = _axes(ax, "relative error of the gradient", "")
    smallest = 1e-16  # a right gradient may have no error at all
    for row, item in enumerate(judged):
        look = style(item["contact"])
        ax.plot([max(item["relative_error"], smallest)], [row], color=look["color"], marker=look["marker"] or "o",
                fillstyle=look["fillstyle"], linestyle="none")
        ax.annotate(item["verdict"], (1.02, row), xycoords=("axes fraction", "data"), va="center",
                    color=_VERDICTS.get(item["verdict"], "#59636e"))
    ax.set_xscale("log")
    ax.set_yticks(range(len(judged)), [item["contact"] for item in judged])
    ax.invert_yaxis()
    ax.grid(axis="x", linewidth=0.4)
    return ax


def refinement(item: Result, ax: Any = None) -> Any:
    """Draws the error of the gradient of one model, `report.of(contact)`, as a function of the number of steps."""
    ax = _axes(ax, "steps", "error of the gradient")
    for quantity, line in zip(item["refinement"]["quantities"], ("solid", "dashed", "dotted", "dashdot")):
        look = {**style(item["contact"]), "linestyle": line}
        ax.loglog(quantity["steps"], quantity["error"], label=f"by {quantity['quantity']}: {quantity['verdict']}", **look)
    ax.legend(frameon=False)
    return ax


def _scale(values: Any) -> str:
    """Returns "log" if ascending values are spaced more evenly on a logarithmic scale."""
    if len(values) < 2 or values[0] <= 0:
        return "linear"
    spread = [np.ptp(np.diff(each)) / np.mean(np.diff(each)) for each in (values, np.log(values))]
    return "log" if spread[1] < spread[0] or (len(values) == 2 and values[1] > 20 * values[0]) else "linear"


def _edges(values: Any, scale: str) -> Any:
    """Returns the borders of cells around ascending values."""
    at = np.log(values) if scale == "log" else values
    middles = (at[1:] + at[:-1]) / 2
    edges = np.concatenate([[2 * at[0] - middles[0]], middles, [2 * at[-1] - middles[-1]]])
    return np.exp(edges) if scale == "log" else edges


def _done(table: Mapping[str, Any], values: Any) -> Any:
    """Returns which rows are of points that are done: all rows of `values` in a table without a status."""
    return np.asarray(table["status"]) == "done" if "status" in table else np.ones(len(values), dtype=bool)


def _numbers(table: Mapping[str, Any], name: str, argument: str) -> Any:
    """Returns a column of numbers of a sweep."""
    if name not in table:
        raise ValueError(f"{argument}: found {name!r}, expected a column of the table: {', '.join(table)}")
    column = np.asarray(table[name])
    if column.dtype.kind not in "fiub":
        raise ValueError(f"{argument}: found the column {name!r} of text, expected one of numbers")
    return column.astype(float)


def curves(table: Mapping[str, Any], x: str, y: str, ax: Any = None, reduce: Any = np.min) -> Any:
    """Draws a column of a sweep as a function of one of its options, a curve for each contact model and solver.

    `table` is as in heat_maps; `reduce` makes one number of the values at one x, over all other options.
    """
    at, values = _numbers(table, x, "x"), _numbers(table, y, "y")
    ax = _axes(ax, x, y)
    keys = [np.asarray(table[name]) for name in ("contact", "solver") if name in table]
    shown = _done(table, values) & np.isfinite(values)
    for key in dict.fromkeys(zip(*keys)) if keys else [()]:
        of_key = np.logical_and.reduce([shown, *(column == word for column, word in zip(keys, key))])
        xs = np.unique(at[of_key])
        look = {**style(str(key[0])), "markevery": None} if len(key) else {}
        ax.plot(xs, [reduce(values[of_key & (at == each)]) for each in xs], label=" ".join(key), **look)
    ax.set_xscale(_scale(np.unique(at)))
    if keys:
        ax.legend(frameon=False)
    return ax


def heat_maps(
    table: Mapping[str, Any], x: str, y: str, columns: Sequence[str] | None = None, clip: float = 2, reduce: Any = np.min
) -> Any:
    """Draws a heat map of each column of a sweep over two of its options, and returns the figure.

    The colour scale of a map ends at the percentiles ``clip`` and 100 - ``clip`` of its values, so that a few extreme
    points do not hide the others; arrows at its ends mark values beyond. It is logarithmic where these percentiles are
    positive and two decades apart. Cells of points that failed are empty.

    Args:
        table: columns by their names, as saltus.sweep returns them, or an opened sweep.npz.
        x: option on the horizontal axis.
        y: option on the vertical axis.
        columns: columns to draw; default: all columns of numbers that differ, other than x and y.
        clip: percentage of the values beyond each end of the colour scale.
        reduce: function that makes one number of the values of a cell, over all other options; default: the least.
    """
    of_x, of_y = _numbers(table, x, "x"), _numbers(table, y, "y")
    at_x, at_y = np.unique(of_x), np.unique(of_y)
    if len(at_x) < 2 or len(at_y) < 2:
        raise ValueError(f"{x}, {y}: expected at least two values of each; saltus.plot.curves draws one option")
    done = _done(table, of_x)
    if columns is None:
        candidates = [name for name in table if name not in (x, y, "point") and np.asarray(table[name]).dtype.kind in "fi"]
    else:
        candidates = [columns] if isinstance(columns, str) else list(columns)
    shown = {name: _numbers(table, name, "columns") for name in candidates}
    if columns is None:
        shown = {name: cells for name, cells in shown.items() if len(np.unique(cells[done & np.isfinite(cells)])) > 1}
    if not shown:
        raise ValueError("columns: found none whose numbers differ; expected at least one")
    across = min(3, len(shown))
    down = -(-len(shown) // across)
    figure, axes = plt.subplots(down, across, figsize=(4.2 * across, 3.4 * down), layout="constrained", squeeze=False)
    scales = _scale(at_x), _scale(at_y)
    row, column = np.searchsorted(at_y, of_y), np.searchsorted(at_x, of_x)
    for ax in axes.flat[len(shown) :]:
        ax.set_axis_off()
    for ax, (name, values) in zip(axes.flat, shown.items()):
        drawn = np.full((len(at_y), len(at_x)), np.nan)
        inside = done & np.isfinite(values)
        for cell in set(zip(row[inside], column[inside])):
            drawn[cell] = reduce(values[inside & (row == cell[0]) & (column == cell[1])])
        finite = drawn[np.isfinite(drawn)]
        ax.set(title=name.replace("_", " "), xlabel=x, ylabel=y)
        if not len(finite):
            continue
        least, most = np.percentile(finite, [clip, 100 - clip])
        norm = LogNorm(least, most) if least > 0 and most >= 100 * least else Normalize(least, most)
        mesh = ax.pcolormesh(_edges(at_x, scales[0]), _edges(at_y, scales[1]), np.ma.masked_invalid(drawn), norm=norm)
        beyond = (finite.min() < least, finite.max() > most)
        extend = {(False, False): "neither", (True, False): "min", (False, True): "max"}.get(beyond, "both")
        figure.colorbar(mesh, ax=ax, extend=extend)
        ax.set(xscale=scales[0], yscale=scales[1])
    return figure
