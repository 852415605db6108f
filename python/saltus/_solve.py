"""Solvers and audits."""

from __future__ import annotations

from typing import Any, Callable, Mapping, Sequence

from . import _saltus
from ._results import Audit, Run
from ._scene import SceneLike, as_scene


def contact_models() -> dict[str, str]:
    """The contact models, each with one line about it."""
    return _saltus.contact_models()


def solvers() -> dict[str, str]:
    """The solvers, each with one line about it."""
    return _saltus.solvers()


def solve(
    scene: SceneLike,
    contact: Any = "event",
    solver: str = "gd",
    *,
    precision: str = "double",
    iterations: int = 1000,
    learning_rate: float | None = None,
    rate_per_time: bool = False,
    sequence: str = "auto",
    surrogate: str | Mapping[str, Any] | None = None,
    threads: int = 0,
    memory_limit: float = 1024,
    keep_iterates: bool = False,
    callback: Callable[[int, float], bool | None] | None = None,
    status: Callable[[str], None] | None = None,
) -> Run:
    """Optimises what the scene says, under a contact model, with a solver.

    iterations: at most. learning_rate, rate_per_time: of gradient descent; the default rate is that of the published
    experiments. sequence: of solvers along a collision sequence: "auto", "fixed", "none" or pairs such as
    "striker-target,target-ceiling". surrogate: "smoothed_zeroth" or a dict of kind, sigma, samples, seed, segments.
    threads: for samples of surrogates; 0 is one per core. memory_limit: MiB, of the states of a rollout.
    keep_iterates: adds ``iterates``, the decision variables after each iteration.
    callback(iteration, loss): called after each iteration; False ends the run as "interrupted". status(text): called by
    solvers that take long with what they are at.

    Returns the run, whose solution is re-simulated exactly and certified. Raises ValueError if solver or model cannot
    take the scene, or an option is wrong; what a callback raises. Ctrl-C raises KeyboardInterrupt, at once; it, and
    what a callback has raised, has the run so far as its attribute ``run``.
    """
    found, stopped_by = _saltus.solve(
        as_scene(scene),
        contact,
        solver,
        precision=precision,
        callback=callback,
        status=status,
        iterations=iterations,
        learning_rate=learning_rate,
        rate_per_time=rate_per_time,
        sequence=sequence,
        surrogate=surrogate,
        threads=threads,
        memory_limit=memory_limit,
        keep_iterates=keep_iterates,
    )
    run = Run(found)
    if stopped_by is not None:
        stopped_by.run = run
        raise stopped_by
    return run


def audit(
    scene: SceneLike,
    contact: str | Sequence[str] = "all",
    *,
    precision: str = "double",
    width_sweep: bool = False,
    surrogate: str | Mapping[str, Any] | None = None,
    threads: int = 0,
) -> Audit:
    """Gradients of contact models beside the exact one, with verdicts and their reasons.

    contact: a model, a list of them, or "all". width_sweep: also compares with differences of every width.
    surrogate: as in `solve`; its error is judged then. threads: 0 is one per core.

    Raises ValueError for unknown names, and if the only model asked for cannot take the scene. Ctrl-C raises
    KeyboardInterrupt.
    """
    names = list(contact_models()) if contact == "all" else [contact] if isinstance(contact, str) else list(contact)
    if not names:
        raise ValueError("contact: found an empty list, expected names of contact models")
    return Audit(
        _saltus.audit(
            as_scene(scene), names, precision=precision, width_sweep=width_sweep, surrogate=surrogate, threads=threads
        )
    )
