"""Motions, losses and gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _saltus
from . import _hybrid
from ._hybrid import HybridProblem
from ._own import as_contact, is_own
from ._progress import CountedProgress
from ._results import Gradient, Rollout
from ._scene import Scene, SceneLike, as_scene
from ._types import Closed, expect, expect_int, expect_none_of, Floats, Remade


class Simulation(Closed, Remade, _saltus.Simulation):
    """A scene under a contact model, to be evaluated many times.

    The decision variables z are what the scene optimizes, in the shape ``shape``: a control (K, C, 2) in N ((K, C, 3)
    with torques in N m), or velocities or positions (F, 2) of the F free discs. If the final time or angular velocities
    are free too, z is flat, with these at the end. A flat array with as many numbers is accepted. None stands for the
    initial guess.

    Several threads may use one simulation, one after the other.

    Args:
        scene: a Scene, a dict or the path of a scene file.
        contact: name of a contact model, or a class derived from ContactModel.
        precision: arithmetic of the contact model, "double" or "float".
        memory_limit: MiB, for the states of a rollout. States that do not fit are computed again.

    Attributes:
        scene: the scene.
        contact: name of the contact model.
        shape: shape of the decision variables.
        num_variables: number of decision variables.
        num_steps: number of steps, K.
        initial_guess: the initial guess, of shape ``shape``.
        remarks: the remarks on the motion of the last call, a list of ``kind`` and ``text``: steps by the time-stepping
            fallback, and simultaneous impacts whose order changes the motion.

    Raises:
        ValueError: an argument is wrong, or the model does not support the scene.
        TypeError: an argument has a wrong type.
        RuntimeError: a rollout fails.

    Methods:
        loss(z=None): the loss at z.
        loss_and_gradient(z=None, out=None): the loss and its gradient, in a new array of the shape of z, or in ``out``.
        residuals(z=None): the residuals (R,) whose squares are the loss without the effort, and their Jacobian (R,
            num_variables).
        rollout(z=None, out=None): a dict with ``states`` (K + 1, B, 4 or 6; in ``out`` if it is given), ``times``
            (K + 1), ``loss``, ``events`` and ``remarks``.
        step(state, force=None): the state (B, 4 or 6) after one step under forces (C, 2); None stands for those of the
            scene.
        linearize(state, force=None): the derivatives of that step with respect to the state, (S, S) with S the size of
            a state, and with respect to the forces, (S, C, 2).
    """

    _attributes = ("scene", "contact", "shape", "num_variables", "num_steps", "initial_guess")

    def __init__(
        self, scene: SceneLike, contact: Any = "event", *, precision: str = "double", memory_limit: float = 1024
    ):
        expect("text", precision=precision)
        expect("a number", memory_limit=memory_limit)
        self._arguments = {
            "scene": as_scene(scene), "contact": contact, "precision": precision, "memory_limit": memory_limit
        }
        super().__init__(
            self._arguments["scene"], as_contact(contact), precision=precision, memory_limit=memory_limit
        )


class Batch(Closed, Remade, _saltus.Batch):
    """Losses and gradients at many points, on all cores, with the same bits for any number of threads.

    Results are new arrays, or the given ones. If a rollout fails, its loss and gradient are NaN.

    Args:
        scene, contact, precision: as those of Simulation.
        threads: number of threads; 0 is one per core.
        progress: whether a line on stderr shows the progress after two seconds; default: on terminals and in notebooks.

    Methods:
        remarks(points): a list of the remarks on the motion of each point, which is simulated again.
    """

    def __init__(self, scene: SceneLike, contact: Any = "event", *, precision: str = "double", threads: int = 0,
                 progress: bool | None = None):
        expect("text", precision=precision)
        expect_int(threads=threads)
        CountedProgress("batch", progress)
        self._arguments = {"scene": as_scene(scene), "contact": contact, "precision": precision, "threads": threads,
                           "progress": progress}
        # Python's exceptions come out of the thread that called.
        super().__init__(
            self._arguments["scene"],
            as_contact(contact),
            precision=precision,
            threads=1 if is_own(contact) else threads,
        )

    def loss(self, points: ArrayLike, losses: Floats | None = None) -> Floats:  # type: ignore[override]
        """Returns the losses (P,) at points (P, num_variables), or (P, ...) in the shape of z."""
        with CountedProgress("batch", self._arguments["progress"]) as shown:
            return super().loss(points, losses, shown.counter)

    def loss_and_gradient(  # type: ignore[override]
        self, points: ArrayLike, losses: Floats | None = None, gradients: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Returns the losses (P,), and the gradients (P, num_variables)."""
        with CountedProgress("batch", self._arguments["progress"]) as shown:
            return super().loss_and_gradient(points, losses, gradients, shown.counter)


class EndState(Closed, Remade, _saltus.EndState):
    """The final state as a function of the initial state and the control, for automatic differentiation by other packages.

    ``end(initial, control)`` returns the final state in the shape of ``initial``. saltus.torch makes a function of torch
    from it. Errors are those of Simulation.

    Args:
        scene, contact, precision: as those of Simulation.

    Attributes:
        initial: initial state of the scene, (B, 4), or (B, 6) with discs that have rotational inertia.
        control: initial control of the scene, (K, C, 2).
        remarks: the remarks on the motion of the last call, as those of Simulation.

    Methods:
        vjp(initial, control, cotangent): the gradients of sum(cotangent * end(initial, control)) with respect to initial
            state and control, by one adjoint. The motion of the last call is not simulated again. The gradient is 0 for
            fixed discs.
    """

    _attributes = ("initial", "control")

    def __init__(self, scene: SceneLike, contact: Any = "event", *, precision: str = "double"):
        expect("text", precision=precision)
        self._arguments = {"scene": as_scene(scene), "contact": contact, "precision": precision}
        super().__init__(self._arguments["scene"], as_contact(contact), precision=precision)


def _start(scene: SceneLike, start: tuple[Any, Any, Any, Any], by_control: bool) -> _saltus.Scene:
    """Returns the scene with another initial state; with `by_control` as if it optimized its control."""
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

    Args:
        scene: a Scene, a dict or the path of a scene file.
        contact: name of a contact model, or a class derived from ContactModel.
        control: forces (K, C, 2) in N on the C controlled discs, one row for each step of the contact model, or (K, C, 3)
            with torques in N m; default: those of the scene.
        position, velocity: initial positions and velocities of all discs, (B, 2), m and m/s; default: those of the scene.
        angle, angular_velocity: initial angles and angular velocities, (B,), rad and rad/s; 0 for discs without
            rotational inertia.
        precision: arithmetic of the contact model, "double" or "float".
        memory_limit: MiB, for the states.

    Returns:
        The motion: a Rollout, or a HybridRollout.

    Raises:
        ValueError: the model does not support the scene, or an argument is wrong.
        RuntimeError: the rollout fails; that of a HybridProblem whose events accumulate has the time as ``accumulation``.
    """
    if isinstance(scene, HybridProblem):
        expect_none_of(
            rollout, contact=contact, control=control, position=position, velocity=velocity, angle=angle,
            angular_velocity=angular_velocity, precision=precision, memory_limit=memory_limit,
        )
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
    """Computes the loss of a motion and its gradient with respect to positions, velocities, control and parameters, and in
    scenes with rotational inertia angles and angular velocities.

    Arguments and errors are those of `rollout`. Simulation evaluates a scene many times without repeating the set-up. It
    also supports path costs, constraints and a free final time, which this function refuses.

    Of a HybridProblem it computes the loss and its gradient with respect to the initial state, the control, the parameters
    and the duration; there are no other arguments. The number of integration steps is kept from call to call while it gives
    the accuracy that ``tolerance`` asks for, which each call checks at the price of about half a rollout. It raises
    RuntimeError where a derivative is not finite, with function, mode, time and variable.

    Returns:
        A Gradient, or a HybridGradient.
    """
    if isinstance(scene, HybridProblem):
        expect_none_of(
            loss_and_gradient, contact=contact, control=control, position=position, velocity=velocity, angle=angle,
            angular_velocity=angular_velocity, precision=precision,
        )
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
    """Linearizes every step x_{k+1} = f(x_k, u_k) along a motion.

    Arguments and errors are those of `rollout`.

    Returns:
        A of shape (K, S, S), the derivatives with respect to the state, flattened to S numbers, and B of shape
        (K, S, C, 2), the derivatives with respect to the control.
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
