"""Simulators and contact models of a user's own."""

from __future__ import annotations

from typing import Any, Callable

import numpy as np

from . import _saltus
from ._scene import Scene
from ._types import Floats

# What a simulator is asked: kind, scene, dt, initial (B, 4), control (K, C, 2) or force (B, 2), cotangent (B, 4).
_Answerer = Callable[[str, Scene, float, Floats, Floats, Any], "dict[str, Any]"]


def _difference_width(x: Floats, scale: float) -> Floats:
    """Returns the widths of central differences: the cube root of the rounding, relative."""
    return np.asarray(np.cbrt(np.finfo(float).eps) * np.maximum(np.abs(x), scale))


def _by_differences(step: Callable[..., Any], state: Floats, force: Floats, h: float) -> tuple[Any, Any]:
    """Returns the derivatives of one step, (4 B, 4 B) and (4 B, 2 B), by central differences."""
    blocks = []
    for index, given in enumerate((state, force)):
        columns = []
        widths = _difference_width(given, float(np.max(np.abs(given), initial=1.0)))
        for place in np.ndindex(given.shape):
            above, below = given.copy(), given.copy()
            above[place] += widths[place]
            below[place] -= widths[place]
            width = above[place] - below[place]
            # A step may write to its arguments, and return the same array every time.
            ends = [np.array(step(*((x, force.copy()) if index == 0 else (state.copy(), x)), h)) for x in (above, below)]
            columns.append(np.ravel(ends[0] - ends[1]) / width)
        blocks.append(np.array(columns).T)
    return blocks[0], blocks[1]


class ContactModel:
    """Base class of contact models in Python, which are accepted wherever a contact model is named.

    Derive a class from it, implement ``step``, and pass the class: ``saltus.rollout(scene, MyModel)``. One object is made
    for each scene. A step in Python takes about a thousand times as long as one in C++. Solvers that work on phases
    between impacts, and derivatives with respect to parameters, support built-in models only.

    Attributes:
        name: name of the model in results: text without colons, commas and blanks.
        scene: the scene that the object is made for.
    """

    name = "own"

    def __init__(self, scene: Scene):
        self.scene = scene

    def step(self, x: Floats, u: Floats, h: float) -> Floats:
        """Returns the states (B, 4) of all discs, [p_x p_y v_x v_y], after a step.

        The result must depend on the arguments only. The method may write to x and u, which are its own copies, and may
        return x or an array that it uses again.

        Args:
            x: states before the step, (B, 4).
            u: forces on all discs, (B, 2), N.
            h: length of the step, s.
        """
        raise NotImplementedError(f"{type(self).__name__} needs a method step(x, u, h)")

    def jacobian(self, x: Floats, u: Floats, h: float) -> tuple[Floats, Floats]:
        """Returns the derivatives of `step` with respect to x, (4 B, 4 B), and u, (4 B, 2 B).

        These are central differences unless a derived class overrides the method.
        """
        return _by_differences(self.step, x, u, h)


class Stepper:
    """Answers the requests to a black box by the steps of a contact model."""

    def __init__(self, model: type[ContactModel]):
        self._make = model
        self._model: ContactModel | None = None

    def _of(self, scene: Scene) -> ContactModel:
        model = self._model  # threads that use other scenes replace it
        if model is None or model.scene is not scene:
            model = self._make(scene)
            model.scene = scene
            self._model = model
        return model

    def __call__(
        self, kind: str, scene: Scene, dt: float, initial: Floats, control: Floats, of_final: Any
    ) -> dict[str, Any]:
        model = self._of(scene)
        if kind == "step":
            return {"final state": model.step(initial, control, dt)}
        pushed = [scene.bodies.index(name) for name in scene.controlled]
        states, forces = [initial], np.zeros((len(control), len(initial), 2))
        forces[:, pushed] = control
        for force in forces:
            states.append(_state(model, model.step(states[-1].copy(), force.copy(), dt), initial.shape))
        answer: dict[str, Any] = {"final state": states[-1], "states": np.array(states)}
        if kind == "gradient":
            costate, by_control = np.ravel(of_final), np.zeros_like(control)
            for k in reversed(range(len(control))):
                A, B = model.jacobian(states[k].copy(), forces[k].copy(), dt)
                by_control[k] = (costate @ B).reshape(-1, 2)[pushed]
                costate = costate @ A
            answer["gradient by the initial state"] = costate.reshape(initial.shape)
            answer["gradient by the control"] = by_control
        return answer


def _state(model: ContactModel, value: Any, shape: tuple[int, ...]) -> Floats:
    """Returns a copy of the state that a step has returned."""
    try:
        state = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{model.name}: step: found {type(value).__name__}, expected numbers {shape}: {error}") from error
    if state.shape != shape:
        raise ValueError(f"{model.name}: step: found shape {state.shape}, expected {shape}")
    return state


class Simulator:
    """Answers the requests to a black box by callables of a user."""

    def __init__(self, simulate: Any, gradient: Any, vjp: Any, jacobian: Any, step: Any):
        gradients = {"gradient": gradient, "vjp": vjp, "jacobian": jacobian}
        for key, value in {"simulate": simulate, **gradients, "step": step}.items():
            if value is not None and not callable(value):
                raise TypeError(f"{key}: found {type(value).__name__}, expected a callable")
        given = [key for key, value in gradients.items() if value is not None]
        if len(given) > 1:
            raise ValueError(f"{given[1]}: found beside {given[0]}, expected one of them")
        if gradient is not None and step is not None:  # blame is pulled back by cotangents that are no loss's
            raise ValueError("step: found beside gradient, expected it alone, or beside vjp or jacobian")
        self._simulate, self._gradient, self._vjp, self._jacobian = simulate, gradient, vjp, jacobian
        self._step = step
        # Of what: "loss", "final state", or "" without one.
        self.gradient_of = "loss" if gradient is not None else "final state" if given else ""
        self.has_step = step is not None

    def __call__(
        self, kind: str, scene: Scene, dt: float, initial: Floats, control: Floats, of_final: Any
    ) -> dict[str, Any]:
        if kind == "step":
            return {"final state": self._step(scene, initial, control, dt)}
        answer = {"final state": self._simulate(scene, initial.copy(), control.copy(), dt)}
        if kind == "gradient":
            if self._gradient is not None:
                by_initial, by_control = _pair("gradient", self._gradient(scene, initial, control, dt))
            elif self._vjp is not None:
                by_initial, by_control = _pair("vjp", self._vjp(scene, initial, control, dt, of_final))
            else:
                by_initial, by_control = _pair("jacobian", self._jacobian(scene, initial, control, dt))
                cotangent = np.ravel(of_final)
                by_initial = cotangent @ _matrix("jacobian by the initial state", by_initial, initial)
                by_control = cotangent @ _matrix("jacobian by the control", by_control, control, len(cotangent))
            answer["gradient by the initial state"] = by_initial
            answer["gradient by the control"] = by_control
        return answer


def _pair(name: str, value: Any) -> tuple[Any, Any]:
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ValueError(f"{name}: found {type(value).__name__}, expected a pair: by initial state and by control")
    return value[0], value[1]


def _matrix(name: str, value: Any, by: Floats, rows: int | None = None) -> Floats:
    matrix, expected = np.asarray(value, dtype=float), (rows or by.size, by.size)
    if matrix.shape != expected:
        raise ValueError(f"{name}: found shape {matrix.shape}, expected {expected}")
    return matrix


def is_own(contact: Any) -> bool:
    """Returns whether this is a class of a contact model in Python."""
    return isinstance(contact, type) and issubclass(contact, ContactModel)


def has_jacobian(model: type[ContactModel]) -> bool:
    """Returns whether the model implements its derivatives itself."""
    return model.jacobian is not ContactModel.jacobian


def as_contact(contact: Any) -> Any:
    """Returns the argument of the extension module: a name, or the contact model of a class."""
    if is_own(contact):
        if "_contact" not in contact.__dict__:
            contact._contact = _saltus.Contact(contact.name, Stepper(contact))
        return contact._contact
    if isinstance(contact, ContactModel):
        raise TypeError(f"contact: found an object of {type(contact).__name__}, expected the class itself")
    return contact
