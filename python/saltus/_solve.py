"""Solvers and audits."""

from __future__ import annotations

from typing import Any, Callable, Mapping, Sequence

from . import _hybrid, _saltus
from ._hybrid import HybridProblem, HybridRun
from ._own import Simulator, Stepper, as_contact, has_jacobian, is_own
from ._progress import Progress
from ._results import Audit, Run
from ._scene import SceneLike, as_scene, of_run
from ._types import expect, expect_int, expect_names, expect_none_of


def contact_models() -> dict[str, str]:
    """Returns the names of the contact models, each with a description in one line."""
    return _saltus.contact_models()


def solvers() -> dict[str, str]:
    """Returns the names of the solvers, each with a description in one line."""
    return _saltus.solvers()


def solve(
    scene: SceneLike | HybridProblem,
    contact: Any = "event",
    solver: str | None = None,
    *,
    optimize: Sequence[str] | None = None,
    bounds: Mapping[str, Any] | None = None,
    precision: str = "double",
    iterations: int = 1000,
    learning_rate: float | None = None,
    rate_per_time: bool = False,
    sequence: str | Sequence[str | tuple[str, str]] = "auto",
    start: Run | HybridRun | None = None,
    guess_states: Any = None,
    surrogate: str | Mapping[str, Any] | None = None,
    threads: int = 0,
    memory_limit: float = 1024,
    keep_iterates: bool = False,
    callback: Callable[[int, float], bool | None] | None = None,
    status: Callable[[str], None] | None = None,
    seconds: float = 0,
    progress: bool | None = None,
) -> Any:
    """Optimises a scene under a contact model, or a HybridProblem, with a solver.

    The solution is simulated again with exact dynamics and certified. Ctrl-C raises KeyboardInterrupt at once. This
    exception, and one that a callback raises, has the run computed until then as its attribute ``run``.

    Args:
        scene: a Scene, a dict or the path of a scene file, or a HybridProblem.
        contact: name of a contact model, or a class derived from ContactModel.
        solver: name of a solver; those of a HybridProblem are hybrid_solvers(). Without one it is auto, or gd if a learning
            rate is given.
        optimize: of a HybridProblem, some of "control", "initial", "parameters", "duration" and the names of initial states
            and parameters; default: those of the problem.
        bounds: of a HybridProblem, pairs (least, greatest) by these names, or by the name of a control; default: those of
            the problem for what is optimized.
        precision: arithmetic of the contact model, "double" or "float".
        iterations: largest number of iterations.
        learning_rate: step size of gradient descent; default: that of the published experiments, 0.01 for a HybridProblem.
        rate_per_time: whether the learning rate is per unit of time.
        sequence: collision sequence of ceres_event, ceres_phases, hmp and mode_search: "auto", "fixed", "none" or pairs
            such as "striker-target,target-ceiling". Of a HybridProblem, a list of names of events, each alone or in a pair
            with the mode that it leads to: ceres_phases (the default then) and ipopt solve along it, whatever the events of
            the guess are.
        start: a run from which to start: its control on its own intervals, its duration, and the initial velocities or
            positions that are free. Solvers on equal steps take the mean of the control over each of them. Of a
            HybridProblem what is free of its control, initial state, parameters and duration; the intervals of the control
            are stretched to a duration that is not free.
        guess_states: of a HybridProblem, states (R, n) at equal times from 0 to its duration, R >= 2. Solvers in phases
            begin from them, with the events of the motion under the control, if it has any.
        surrogate: "smoothed_zeroth" or another surrogate gradient, or a dict of kind, sigma, samples, seed, segments.
        threads: number of threads for samples of surrogates; 0 is one per core.
        memory_limit: MiB, for the states of a rollout.
        keep_iterates: whether the run has ``iterates``, the decision variables after each iteration.
        callback: called as callback(iteration, loss) after each iteration; False ends the run as "interrupted".
        status: called as status(text) with the progress of solvers that take long.
        seconds: limit of time, s, after which the run ends as "interrupted" with what it has; 0 is no limit.
        progress: whether a line on stderr shows the progress after two seconds; default: on terminals and in notebooks.

    A HybridProblem takes optimize, bounds, iterations, learning_rate, sequence, start, guess_states, callback, seconds and
    progress.

    Returns:
        A Run, or a HybridRun.

    Raises:
        ValueError: the solver or the model does not support the scene, or an option is wrong.
    """
    along = None if sequence == "auto" else sequence
    if isinstance(scene, HybridProblem) and along is not None:
        solver = solver or "ceres_phases"
        if solver not in ("ceres_phases", "ipopt"):
            raise ValueError(f"sequence: found one for the solver {solver!r}, expected ceres_phases or ipopt")
    if solver is None:
        solver = "auto" if learning_rate is None and not rate_per_time else "gd"
    expect("text", solver=solver, precision=precision)
    expect_int(iterations=iterations, threads=threads)
    expect("a number", memory_limit=memory_limit, seconds=seconds, learning_rate=0 if learning_rate is None else learning_rate)
    expect("True or False", rate_per_time=rate_per_time, keep_iterates=keep_iterates)
    expect("a callable", callback=callback, status=status)
    if isinstance(scene, HybridProblem):
        rate = 0.01 if learning_rate is None else float(learning_rate)
        expect_none_of(
            solve, contact=contact, precision=precision, rate_per_time=rate_per_time, surrogate=surrogate, threads=threads,
            memory_limit=memory_limit, keep_iterates=keep_iterates, status=status,
        )
        free = scene.optimize if optimize is None else optimize
        problem = scene if start is None else scene._begun_by(start, free)
        with Progress("solve", progress, iterations) as shown:
            return _hybrid.solve(
                problem, solver, free, bounds, iterations, rate, guess_states, shown.callback(callback), along, seconds
            )
    expect("text", sequence=sequence)
    if optimize is not None or bounds is not None:
        raise ValueError("optimize and bounds are for a HybridProblem; a scene defines what is free")
    if guess_states is not None:
        raise ValueError("guess_states is for a HybridProblem; a scene starts from the control of a run")
    given: Any = as_scene(scene)
    guess = None
    if start is not None:
        if not isinstance(start, Run):
            raise TypeError(f"start: found {type(start).__name__}, expected a Run")
        given, *guess = of_run(given, start)
    with Progress("solve", progress, iterations) as shown:
        found, page, stopped_by = _saltus.solve(
            given,
            as_contact(contact),
            solver,
            precision=precision,
            callback=shown.callback(callback),
            status=shown.status(status),
            iterations=iterations,
            learning_rate=learning_rate,
            rate_per_time=rate_per_time,
            sequence=sequence,
            guess=guess,
            surrogate=surrogate,
            threads=1 if is_own(contact) else threads,
            memory_limit=memory_limit,
            keep_iterates=keep_iterates,
            seconds=float(seconds),
        )
    run = Run(found)
    run._page = None if is_own(contact) else page
    if stopped_by is not None:
        stopped_by.run = run  # type: ignore[attr-defined]
        raise stopped_by
    return run


def bound_globally(
    scene: SceneLike, loss: float, *, gap: float = 1e-6, seconds: float = 0.0, boxes: int = 400_000,
    progress: bool | None = None
) -> dict[str, Any]:
    """Bounds the loss of all controls from below, rigorously, over all sequences of impacts.

    Ctrl-C raises KeyboardInterrupt, which has what is proved until then as its attribute ``bound``.

    Args:
        scene: a Scene, a dict or the path of a scene file: discs and planes without friction, with a quadratic effort and
            quadratic terminal costs.
        loss: that of a known motion, such as ``solve(scene, "event", "mode_search")["exact_loss"]``.
        gap: ends as soon as ``loss`` less the bound is at most this.
        seconds: limit of the CPU time of the process; 0 is no limit.
        boxes: limit of the number of boxes; 0 is no limit. The default is that of the solver "global".
        progress: whether a line on stderr shows the progress after two seconds; default: on terminals and in notebooks.

    Returns:
        A dict of ``loss``, ``lower_bound``, ``gap``, ``boxes``, ``complete`` (whether the gap was reached), ``remarks`` (such
        as that a limit ended it, or that no motion has this loss), and the parts of all motions that are ``left`` and ``excluded``, each with its ``sequence`` of the impacts that decide about the
        loss, ``repeated`` by impact (the pair may touch again before one of its discs touches another one), ``open``
        (any impacts follow), ``lower_bound`` and ``boxes``.

    Raises:
        ValueError: the bound does not support the scene, or an option is wrong.
    """
    expect("a number", loss=loss, gap=gap, seconds=seconds)
    expect("a whole number", boxes=boxes)
    if not 0 <= boxes < 2**63:
        raise ValueError(f"boxes: found {boxes}, expected a whole number >= 0; 0 is no limit")
    with Progress("bound", progress):
        found, stopped_by = _saltus.bound_globally(
            as_scene(scene), float(loss), gap=float(gap), seconds=float(seconds), boxes=boxes
        )
    if stopped_by is not None:
        stopped_by.bound = found
        raise stopped_by
    return found


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
    audit_seconds: float = 0,
    seconds: float = 0,
    progress: bool | None = None,
) -> Any:
    """Compares the gradients of contact models, of a simulator of your own or of a time-stepping scheme with the exact one.

    A gradient of a simulator is compared with the exact one and with differences of the results of ``simulate``
    (``agrees_with_differences``). Without a gradient, these differences are judged, of a width that follows from the
    measured precision. ``report.raise_if_wrong()`` makes a test of the audit. Ctrl-C raises KeyboardInterrupt. This exception, and one that
    ``simulate`` raises, has the models that were audited until then as its attribute ``audit``.

    Args:
        scene: a Scene, a dict or the path of a scene file.
        contact: a contact model, a list of them, or "all", the default without ``simulate``. A class derived from
            ContactModel is audited by its answers, as a simulator is.
        simulate: called as simulate(scene, initial, control, dt). Returns the final states (B, 4), [p_x p_y v_x v_y] of
            each disc of ``scene``, from ``initial`` (B, 4) under ``control`` (K, C, 2), forces in N on the discs
            scene.controlled, one row for each step of dt seconds. Each call starts from its own initial state. The audit
            also calls it with other initial states, steps and forces, and with a head-on impact of the first pair alone,
            without gravity, but with a force on the first disc: read parameters from ``scene`` (scene.to_dict()), and
            take the forces from ``control``.
        gradient: called as gradient(scene, initial, control, dt). Returns the simulator's own gradient of the loss of
            ``scene``, the effort included, with respect to initial (B, 4) and control (K, C, 2).
        vjp: in place of gradient, called as vjp(scene, initial, control, dt, cotangent). Returns the same derivatives of
            sum(cotangent * final state).
        jacobian: in place of gradient, called as jacobian(scene, initial, control, dt). Returns the derivatives of the
            final state, of shapes (4 B, 4 B) and (4 B, 2 K C).
        step: called as step(scene, state, force, h). Returns the state after one step from any state (B, 4) under forces
            (B, 2); with it the audit names the wrong contact. Not together with gradient.
        name: name of the simulator in the result.
        precision: arithmetic of the contact models, "double" or "float".
        width_sweep: whether to compare with differences of every width too.
        surrogate: as that of `solve`; its error is judged then.
        threads: number of threads; 0 is one per core.
        audit_seconds: time, s, within which the audit of ``simulate`` is planned, from the time that its first gradient
            takes; 0 is no limit. An audit calls ``simulate`` at most 2000 times, unless a remark states why not. For a
            HybridProblem it limits the refinement beyond its first four levels.
        seconds: limit of time, s, after which the audit has what was judged until then, and the limit as its ``reason``; 0 is
            no limit. A call of ``simulate`` or ``step`` that is at work is waited for.
        progress: whether a line on stderr shows the progress after two seconds; default: on terminals and in notebooks.

    Of a HybridProblem with costs the function audits a time-stepping scheme. It then takes step, a function of some of
    mode, t, x, u, p and h by the names of its arguments, which returns the mode's name and the state after a step of length h; or as simulate a
    command that speaks the line protocol; jacobian, with the arguments of step, which returns the derivatives by [x u p]
    (differences without it); steps, the number of steps at which the refinement begins; width_sweep, name, audit_seconds, seconds and
    progress.

    Returns:
        An Audit, or a HybridAudit.

    Raises:
        ValueError: a name is unknown, a shape is wrong, or the only model does not support the scene.
    """
    if isinstance(scene, HybridProblem):
        expect("text", name=name)
        expect("a number", audit_seconds=audit_seconds, seconds=seconds)
        expect_none_of(
            audit, contact=contact, gradient=gradient, vjp=vjp, precision=precision, surrogate=surrogate, threads=threads
        )
        with Progress("audit", progress):
            return _hybrid.audit(scene, step, jacobian, simulate, steps, width_sweep, name, audit_seconds, seconds)
    if isinstance(simulate, str):
        raise TypeError("simulate: found str, expected a callable; commands are for saltus_audit --simulate")
    if contact is None:
        contact = "all" if simulate is None else []
    models = list(contact_models()) if isinstance(contact, str) and contact == "all" else contact
    models = list(models) if isinstance(models, (list, tuple)) else [models]
    names = expect_names(contact=[as_contact(model) for model in models if not is_own(model)])
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
    expect_int(threads=threads)
    expect("a number", audit_seconds=audit_seconds, seconds=seconds)
    if not names and not own:
        raise ValueError("contact: found an empty list, expected names of contact models")
    with Progress("audit", progress):
        found, stopped_by = _saltus.audit(
            as_scene(scene),
            names,
            own,
            precision=precision,
            width_sweep=width_sweep,
            surrogate=surrogate,
            threads=threads,
            audit_seconds=audit_seconds,
            seconds=float(seconds),
        )
    report = Audit(found)
    if stopped_by is not None:
        stopped_by.audit = report  # type: ignore[attr-defined]
        raise stopped_by
    return report
