"""Motions, losses and gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _saltus
from . import _hybrid
from ._hybrid import HybridProblem
from ._own import as_contact, is_own
from ._results import Gradient, Rollout
from ._scene import Scene, SceneLike, as_scene
from ._types import Floats, expect


class Simulation(_saltus.Simulation):
    """A scene under a contact model, to be evaluated many times.

    ``Simulation(scene, contact="event", *, precision="double", memory_limit=1024)``; memory_limit is in MiB, for the
    states of a rollout. The decision variables z are what the scene optimizes, in the shape ``shape``: a control
    (K, C, 2) in N ((K, C, 3) with torques in N m), or velocities or positions (F, 2) of the discs that are free; flat with the final time or the angular
    velocities behind where these are free. A flat array of as many numbers will do, None is the initial guess.

    Attributes: ``scene``, ``contact``, ``shape``, ``num_variables``, ``num_steps`` (K), ``initial_guess``.

    ``loss(z=None)``
        The loss at z.
    ``loss_and_gradient(z=None, out=None)``
        The loss and its gradient: a new array in the shape of z as given, or `out`.
    ``residuals(z=None)``
        What is squared and summed up in the loss but for the effort, (R,), and its Jacobian (R, num_variables).
    ``rollout(z=None, out=None)``
        A dict with states (K + 1, B, 4 or 6; in `out` if given), times (K + 1), loss, events.
    ``step(state, force=None)``
        The state (B, 4 or 6) after one step, under forces (C, 2); None is the scene's.
    ``linearize(state, force=None)``
        The derivatives of that step by state, (S, S) with S the size of a state, and by force, (S, C, 2).

    Several threads may use one simulation, one after the other; the interpreter is free meanwhile. Ctrl-C ends what
    takes long. Raises ValueError and TypeError, which name the argument and what was expected, and RuntimeError for a
    rollout that fails.
    """

    def __init__(
        self, scene: SceneLike, contact: Any = "event", *, precision: str = "double", memory_limit: float = 1024
    ):
        expect("text", precision=precision)
        expect("a number", memory_limit=memory_limit)
        super().__init__(as_scene(scene), as_contact(contact), precision=precision, memory_limit=memory_limit)


class Batch(_saltus.Batch):
    """Losses and gradients at many points at once, on all cores, with the same bits for any number of threads.

    ``Batch(scene, contact="event", *, precision="double", threads=0)``; 0 is one per core.

    ``loss(points, losses=None)``
        The losses (P,) at points (P, num_variables), or (P, *shape of z); see Simulation.
    ``loss_and_gradient(points, losses=None, gradients=None)``
        These and the gradients (P, num_variables).

    Results are new arrays, or those given. Where a rollout fails, the loss and its gradient are NaN.
    """

    def __init__(self, scene: SceneLike, contact: Any = "event", *, precision: str = "double", threads: int = 0):
        expect("text", precision=precision)
        expect("a whole number", threads=threads)
        # Python's exceptions come out of the thread that called.
        super().__init__(
            as_scene(scene), as_contact(contact), precision=precision, threads=1 if is_own(contact) else threads
        )


class EndState(_saltus.EndState):
    """The final state as a function of the initial state and the control, for automatic differentiation elsewhere.

    ``EndState(scene, contact="event", *, precision="double")``; ``initial`` (B, 4; 6 with discs that spin) and
    ``control`` (K, C, 2) are the scene's own.

    ``end(initial, control)``
        The final state, as `initial`: [p_x p_y v_x v_y] of each disc, and [angle angular_velocity] in scenes with discs
        that spin.
    ``end.vjp(initial, control, cotangent)``
        The gradients of sum(cotangent * end(initial, control)) by initial state and control, by one adjoint; the motion
        is not simulated again if it is that of the last call. 0 for fixed discs.

    Raises as Simulation. saltus.torch makes a function of torch of it.
    """

    def __init__(self, scene: SceneLike, contact: Any = "event", *, precision: str = "double"):
        expect("text", precision=precision)
        super().__init__(as_scene(scene), as_contact(contact), precision=precision)


def _start(scene: SceneLike, start: tuple[Any, Any, Any, Any], by_control: bool) -> _saltus.Scene:
    """The scene from another start; with `by_control` as if its control were what it optimizes."""
    read = as_scene(scene)
    if not by_control and all(given is None for given in start):
        return read
    return _saltus.starting_at(read, *start, by_control)


def rollout(
    scene: SceneLike | HybridProblem,
    contact: Any = "event",
    *,
    control: ArrayLike | None = None,
    position: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    angle: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    precision: str = "double",
    memory_limit: float = 1024,
) -> Any:
    """Simulates a scene, or a HybridProblem, for which there are no other arguments.

    control: forces (K, C, 2) in N on the C pushed discs, one row a step of the contact model; default: the scene's. In
    scenes with torques (K, C, 3), with the torque in N m behind.
    position, velocity: of all discs at the start, (B, 2), m and m/s; default: the scene's. angle, angular_velocity:
    (B,), rad and rad/s, of discs that spin; 0 for the others.

    Returns a Rollout, or a HybridRollout. Raises ValueError if the model cannot take the scene or an argument is wrong,
    RuntimeError if the rollout fails; that of a HybridProblem whose events accumulate has the time as `accumulation`.
    """
    if isinstance(scene, HybridProblem):
        return _hybrid.rollout(scene)
    expect("text", precision=precision)
    given = _start(scene, (position, velocity, angle, angular_velocity), control is not None)
    simulation = _saltus.Simulation(given, as_contact(contact), precision=precision, memory_limit=memory_limit)
    found = simulation.rollout(control)
    return Rollout({"scene": given.name, "contact": simulation.contact, **found})


def loss_and_gradient(
    scene: SceneLike | HybridProblem,
    contact: Any = "event",
    *,
    control: ArrayLike | None = None,
    position: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    angle: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    precision: str = "double",
) -> Any:
    """The loss of a motion and its gradient by all that determines it: position, velocity, control and parameters; with
    discs that spin angle and angular velocity too.

    Arguments as those of `rollout`. To evaluate a scene many times by what it optimizes, use Simulation, which spares
    the set-up. Scenes with hard, running or via terms or a free final time are refused: Simulation takes them.

    Of a HybridProblem: its loss and the gradient by initial state, control, parameters and duration; there are no other
    arguments. The number of steps of the integration is chosen in the first call, and kept as long as mode, intervals and
    duration are the same.

    Returns a Gradient, or a HybridGradient. Raises as rollout.
    """
    if isinstance(scene, HybridProblem):
        return _hybrid.loss_and_gradient(scene)
    expect("text", precision=precision)
    given = _start(scene, (position, velocity, angle, angular_velocity), control is not None)
    return Gradient(_saltus.gradient(given, as_contact(contact), precision, control))


def linearize(
    scene: SceneLike,
    contact: Any = "event",
    *,
    control: ArrayLike | None = None,
    position: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    angle: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    precision: str = "double",
) -> tuple[Floats, Floats]:
    """The linearization of every step along a motion: x_{k+1} = f(x_k, u_k) to first order.

    Returns A (K, S, S), by the state, flattened to S numbers, and B (K, S, C, 2), by the control, in its shape. Arguments and errors
    as those of `rollout`.
    """
    expect("text", precision=precision)
    given = _start(scene, (position, velocity, angle, angular_velocity), control is not None)
    simulation = _saltus.Simulation(given, as_contact(contact), precision=precision)
    states = simulation.rollout(control)["states"]
    rows: list[Any] = [None] * simulation.num_steps if control is None else list(
        np.reshape(np.asarray(control, dtype=float), (simulation.num_steps, -1, 3 if given.turned else 2)))
    if control is None and given.optimize == "control" and len(simulation.shape) == 3:
        rows = list(simulation.initial_guess)
    pairs = [simulation.linearize(state, row) for state, row in zip(states, rows)]
    return np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])
