"""Solvers and audits."""

from __future__ import annotations

from typing import Any, Callable, Mapping, Sequence

from . import _hybrid, _saltus
from ._hybrid import HybridProblem
from ._own import Simulator, Stepper, as_contact, has_jacobian, is_own
from ._results import Audit, Run
from ._scene import SceneLike, as_scene
from ._types import expect


def contact_models() -> dict[str, str]:
    """The contact models, each with one line about it."""
    return _saltus.contact_models()


def solvers() -> dict[str, str]:
    """The solvers, each with one line about it."""
    return _saltus.solvers()


def solve(
    scene: SceneLike | HybridProblem,
    contact: Any = "event",
    solver: str = "gd",
    *,
    optimize: Sequence[str] | None = None,
    bounds: Mapping[str, Any] | None = None,
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
) -> Any:
    """Optimises what the scene says, under a contact model, with a solver; or a HybridProblem with one of hybrid_solvers().

    optimize: of a HybridProblem, some of "control", "initial", "parameters", "duration" and the names of initial states
    and parameters. bounds: a pair (least, greatest) by these names, or by the name of a control. It takes iterations,
    learning_rate (default 0.01) and callback beside these.

    iterations: at most. learning_rate, rate_per_time: of gradient descent; the default rate is that of the published
    experiments. sequence: of solvers along a collision sequence: "auto", "fixed", "none" or pairs such as
    "striker-target,target-ceiling". surrogate: "smoothed_zeroth" or a dict of kind, sigma, samples, seed, segments.
    threads: for samples of surrogates; 0 is one per core. memory_limit: MiB, of the states of a rollout.
    keep_iterates: adds ``iterates``, the decision variables after each iteration.
    callback(iteration, loss): called after each iteration; False ends the run as "interrupted". status(text): called by
    solvers that take long with what they are at.

    Returns the Run, or the HybridRun, whose solution is re-simulated exactly and certified. Raises ValueError if solver or model cannot
    take the scene, or an option is wrong; what a callback raises. Ctrl-C raises KeyboardInterrupt, at once; it, and
    what a callback has raised, has the run so far as its attribute ``run``.
    """
    expect("text", solver=solver, precision=precision, sequence=sequence)
    expect("a whole number", iterations=iterations, threads=threads)
    expect("a number", memory_limit=memory_limit, learning_rate=0 if learning_rate is None else learning_rate)
    expect("True or False", rate_per_time=rate_per_time, keep_iterates=keep_iterates)
    expect("a callable", callback=callback, status=status)
    if isinstance(scene, HybridProblem):
        rate = 0.01 if learning_rate is None else float(learning_rate)
        free = ["control"] if optimize is None else optimize
        return _hybrid.solve(scene, solver, free, bounds or {}, iterations, rate, callback)
    if optimize is not None or bounds is not None:
        raise ValueError("optimize and bounds are of a HybridProblem: a scene says itself what is free")
    found, stopped_by = _saltus.solve(
        as_scene(scene),
        as_contact(contact),
        solver,
        precision=precision,
        callback=callback,
        status=status,
        iterations=iterations,
        learning_rate=learning_rate,
        rate_per_time=rate_per_time,
        sequence=sequence,
        surrogate=surrogate,
        threads=1 if is_own(contact) else threads,
        memory_limit=memory_limit,
        keep_iterates=keep_iterates,
    )
    run = Run(found)
    if stopped_by is not None:
        stopped_by.run = run  # type: ignore[attr-defined]
        raise stopped_by
    return run


def audit(
    scene: SceneLike | HybridProblem,
    contact: Any = None,
    *,
    simulate: Callable[..., Any] | str | None = None,
    gradient: Callable[..., Any] | None = None,
    vjp: Callable[..., Any] | None = None,
    jacobian: Callable[..., Any] | None = None,
    step: Callable[..., Any] | None = None,
    steps: int = 100,
    name: str = "simulate",
    precision: str = "double",
    width_sweep: bool = False,
    surrogate: str | Mapping[str, Any] | None = None,
    threads: int = 0,
) -> Any:
    """Gradients of contact models, or of a simulator of yours, beside the exact one, with verdicts and their reasons.

    contact: a model, a list of them, or "all", which is the default without `simulate`; a ContactModel is audited by
    what it answers, as a simulator is. width_sweep: also compares with differences of every width. surrogate: as in
    `solve`; its error is judged then. threads: 0 is one per core.

    simulate(scene, initial, control, dt)
        The final state (B, 4) of the discs of `scene`, each [p_x p_y v_x v_y], from `initial` (B, 4) under `control`
        (K, C, 2) on those of scene.controlled, one row a step of dt seconds. It starts afresh each time. It is asked of
        this scene with other starts, steps and forces, and of a head-on impact of its first pair alone: what it needs
        of the discs (scene.to_dict()) it should read there.
    gradient(scene, initial, control, dt)
        Its own gradient, of the loss of `scene` with its effort, by initial (B, 4) and by control (K, C, 2). Or
    vjp(scene, initial, control, dt, cotangent)
        likewise, of sum(cotangent * final state). Or
    jacobian(scene, initial, control, dt)
        the derivatives of the final state by them, of shapes (4 B, 4 B) and (4 B, 2 K C). A gradient is compared with
        the exact one and with differences of what `simulate` gives (``agrees_with_differences``). Without one, these
        differences are judged, of a width that their precision allows, which is found.
    step(scene, state, force, h)
        The state after one step from any state (B, 4) under forces (B, 2): names the contact that is wrong. Not beside
        `gradient`.

    Of a HybridProblem with costs it audits a time-stepping scheme of yours, and takes these alone: step(mode, x, u, p, h),
    or (mode, t, x, u, p, h), which returns the mode's name and the state after a step of length h; or simulate, a command
    that speaks the line protocol; jacobian, of the arguments of step, the derivatives by [x u p] (differences without);
    steps, the number of steps at which the refinement begins; width_sweep, name.

    Returns an Audit, or a HybridAudit.

    ``report.raise_if_wrong()`` makes a test of it. Raises ValueError for unknown names and wrong shapes, and if the only
    model asked for cannot take the scene; what a callable raises. Ctrl-C raises KeyboardInterrupt.
    """
    if isinstance(scene, HybridProblem):
        expect("text", name=name)
        return _hybrid.audit(scene, step, jacobian, simulate, steps, width_sweep, name)
    if isinstance(simulate, str):
        raise TypeError("simulate: found text, expected a callable; commands are for saltus_audit --simulate")
    if contact is None:
        contact = "all" if simulate is None else []
    models = list(contact_models()) if isinstance(contact, str) and contact == "all" else contact
    models = list(models) if isinstance(models, (list, tuple)) else [models]
    names = [model for model in models if not is_own(model)]
    own: list[tuple[str, Any, str, bool]] = [
        (model.name, Stepper(model), "final state" if has_jacobian(model) else "", True)
        for model in models
        if is_own(model)
    ]
    if simulate is not None:
        simulator = Simulator(simulate, gradient, vjp, jacobian, step)
        own.append((name, simulator, simulator.gradient_of, simulator.has_step))
    elif gradient or vjp or jacobian or step:
        raise ValueError("simulate: expected a callable beside gradient, vjp, jacobian or step")
    expect("text", precision=precision, name=name)
    expect("a whole number", threads=threads)
    if not names and not own:
        raise ValueError("contact: found an empty list, expected names of contact models")
    return Audit(
        _saltus.audit(
            as_scene(scene),
            names,
            own,
            precision=precision,
            width_sweep=width_sweep,
            surrogate=surrogate,
            threads=threads,
        )
    )
