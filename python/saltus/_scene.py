"""Scenes: from files, from dicts, built in code."""

from __future__ import annotations

import json
import os
from typing import Any, Mapping, Union

import numpy as np

from . import _saltus


class SceneError(ValueError):
    """What is wrong in a scene, and where.

    Attributes: ``file`` (a path, or "scene" for a dict), ``line`` (from 1; 0 for a dict), ``key`` (a path such as
    "bodies[1].radius") and ``message`` (what was found and what was expected).
    """

    def __init__(self, file: str, line: int, key: str, message: str):
        self.file, self.line, self.key, self.message = file, line, key, message
        place = file if file == "scene" else f"{file}:{line}"
        super().__init__(": ".join(part for part in (place, key, message) if part))


def _plain(value: Any) -> Any:
    """What json cannot write of numpy's."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (tuple, set)):
        return list(value)
    raise TypeError(f"scene: found {type(value).__name__}, expected numbers, text, lists and dicts")


class Scene(_saltus.Scene):
    """A planar scene of discs: what moves, what acts on it and what is to be minimised. It cannot be changed.

    ``Scene(data)`` with a dict, or ``Scene(name=..., duration=..., steps=..., bodies=[...], ...)``: the keys of a scene
    file (SI units, radians, vectors ``[x, y]``), validated with the same messages.

    Attributes: ``name``, ``duration`` (s), ``steps``, ``dt`` (s), ``optimize``, ``bodies``, ``controlled`` and
    ``turned`` (names),
    ``position`` (B, 2) in m and ``velocity`` (B, 2) in m/s at the start; ``spins``, whether there are discs that spin (a
    body has an ``inertia``), and their ``angle`` (B,) in rad and ``angular_velocity`` (B,) in rad/s.

    Raises SceneError.
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
        """The keys of the scene file, defaults written out. ``Scene(scene.to_dict()) == scene``."""
        if not hasattr(self, "_json"):
            self._json = json.dumps(self._to_dict())
        plain: dict[str, Any] = json.loads(self._json)
        return plain

    def to_yaml(self) -> str:
        """The text of a scene file."""
        return self._text()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a scene file."""
        with open(path, "w", encoding="utf-8") as file:
            file.write(self.to_yaml())

    def replace(self, changes: Mapping[str, Any] | None = None, /, **keys: Any) -> "Scene":
        """Another scene with some keys changed: ``scene.replace(steps=960)``. Of a key with keys of its own only those
        given change: ``scene.replace(contact={"friction": 0.1})``."""
        data = self.to_dict()
        for key, value in {**(changes or {}), **keys}.items():
            both = isinstance(value, Mapping) and isinstance(data.get(key), Mapping)
            data[key] = {**data[key], **value} if both else value
        return Scene(data)

    def __reduce__(self) -> Any:
        return (Scene, (self.to_dict(),))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        if "_made" not in self.__dict__:  # tracebacks show what could not be made, too
            return "<saltus.Scene that is none>"
        return f"<saltus.Scene {self.name}: {len(self.bodies)} discs, {self.steps} steps of {self.dt:g} s>"


SceneLike = Union[Scene, Mapping[str, Any], str, "os.PathLike[str]"]


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene in a YAML file.

    Raises SceneError, which names file, line, key and what was expected, and OSError.
    """
    with open(path, "rb") as file:
        return Scene._of_text(file.read(), os.fspath(path))


def as_scene(scene: SceneLike) -> Scene:
    """A scene, or what makes one: a dict, or the path of a file."""
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, Mapping):
        return Scene(scene)
    if isinstance(scene, (str, os.PathLike)):
        return load_scene(scene)
    raise TypeError(f"scene: found {type(scene).__name__}, expected a Scene, a dict or the path of a scene file")
