"""Scenes: from files, from dicts, built in code."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any, Mapping, Union

import numpy as np

from . import _saltus
from ._results import number_array
from ._types import expect_path


class SceneError(ValueError):
    """An error in a scene, with its place.

    Attributes: ``file`` (a path, or "scene" for a dict), ``line`` (from 1; 0 for a dict), ``key`` (a path such as
    "bodies[1].radius") and ``message`` (what was found and what was expected).
    """

    def __init__(self, file: str, line: int, key: str, message: str):
        self.file, self.line, self.key, self.message = file, line, key, message
        place = file if file == "scene" else f"{file}:{line}"
        super().__init__(": ".join(part for part in (place, key, message) if part))


def _plain(value: Any) -> Any:
    """Returns values of numpy as values that json can write."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (tuple, set)):
        return list(value)
    raise TypeError(f"scene: found {type(value).__name__}, expected numbers, text, lists and dicts")


class Scene(_saltus.Scene):
    """A planar scene of discs, with its control and its objective. A scene cannot be changed.

    ``Scene(data)`` takes a dict, and ``Scene(name=..., duration=..., steps=..., bodies=[...], ...)`` the keys of a scene
    file (SI units, radians, vectors ``[x, y]``). Both are validated with the same messages as a file.

    Attributes:
        name: name of the scene.
        duration: length of the motion, s.
        steps: number of time steps.
        dt: length of a time step, s.
        optimize: what a solver changes.
        bodies: names of the discs.
        controlled: names of the controlled discs.
        turned: names of the discs with a torque control.
        position: initial positions, (B, 2), m.
        velocity: initial velocities, (B, 2), m/s.
        spins: whether a disc has rotational inertia.
        angle: initial angles, (B,), rad.
        angular_velocity: initial angular velocities, (B,), rad/s.

    Raises:
        SceneError: the scene is wrong.
    """

    def __init__(self, data: Mapping[str, Any] | None = None, /, **keys: Any):
        merged = {**(data or {}), **keys}
        super().__init__(json.dumps(merged, default=_plain, ensure_ascii=False), "scene")
        self._made = True

    @classmethod
    def _of_text(cls, text: bytes | str, name: str) -> "Scene":
        scene = cls.__new__(cls)
        _saltus.Scene.__init__(scene, text, name)
        scene._made = True
        return scene

    def to_dict(self) -> dict[str, Any]:
        """Returns the keys of the scene file with every default. ``Scene(scene.to_dict()) == scene``."""
        if not hasattr(self, "_json"):
            self._json = json.dumps(self._to_dict())
        plain: dict[str, Any] = json.loads(self._json)
        return plain

    def to_yaml(self) -> str:
        """Returns the text of a scene file."""
        return self._text()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a scene file."""
        with open(path, "w", encoding="utf-8") as file:
            file.write(self.to_yaml())

    def replace(self, changes: Mapping[str, Any] | None = None, /, **keys: Any) -> "Scene":
        """Returns a scene with some keys changed: ``scene.replace(steps=960)``. If the value of a key is a map, only the
        given keys of the map change: ``scene.replace(contact={"friction": 0.1})``."""
        data = self.to_dict()
        for key, value in {**(changes or {}), **keys}.items():
            both = isinstance(value, Mapping) and isinstance(data.get(key), Mapping)
            data[key] = {**data[key], **value} if both else value
        return Scene(data)

    if not TYPE_CHECKING:  # type checkers report an unknown attribute themselves

        def __getattr__(self, name: str) -> Any:
            raise AttributeError(f"a scene has no attribute {name!r}; to_dict() has all keys of its scene file")

    def __reduce__(self) -> Any:
        return (Scene, (self.to_dict(),))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        if "_made" not in self.__dict__:  # tracebacks show what could not be made, too
            return "<saltus.Scene that is none>"
        return f"<saltus.Scene {self.name}: {len(self.bodies)} discs, {self.steps} steps of {self.dt:g} s>"


SceneLike = Union[Scene, Mapping[str, Any], str, "os.PathLike[str]"]


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Reads a scene from a YAML file.

    Raises SceneError, which names file, line, key and what was expected, and OSError.
    """
    name = expect_path("load_scene", path)
    with open(name, "rb") as file:
        return Scene._of_text(file.read(), name)


def as_scene(scene: SceneLike) -> Scene:
    """Returns a scene from a Scene, a dict or the path of a file."""
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, Mapping):
        return Scene(scene)
    if isinstance(scene, (str, os.PathLike)):
        return load_scene(scene)
    raise TypeError(f"scene: found {type(scene).__name__}, expected a Scene, a dict or the path of a scene file")


def of_run(scene: _saltus.Scene, run: Mapping[str, Any]) -> tuple[_saltus.Scene, Any, Any]:
    """Returns the scene with the initial state and the parameters of a run, its control, and the lengths of its intervals."""
    if "control" not in run:
        raise ValueError(f"run: found none with a solution: {run.get('reason', '')}")
    keys = ("control", "durations", "position", "velocity", "angular_velocity", "parameters")
    scene = _saltus.starting_from_run(scene, json.dumps({key: run[key] for key in keys if key in run}, default=_plain))
    control = number_array(run["control"])
    intervals = len(control) or scene.steps
    durations = run.get("durations") or [scene.duration / intervals] * intervals
    return scene, control, durations
