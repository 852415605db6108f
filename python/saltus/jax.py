"""Final states, and losses at many points, as functions of jax, with exact derivatives.

    >>> import jax, saltus.jax
    >>> jax.config.update("jax_enable_x64", True)
    >>> losses = saltus.jax.losses(saltus.Batch("problems/two_balls.yaml", "event"))
    >>> points = jax.numpy.ones((3, 480, 1, 2))
    >>> jax.grad(lambda points: losses(points).sum())(points).shape
    (3, 480, 1, 2)

Everything is computed in double precision, on the CPU; arrays of float are converted, and so are their gradients.
Derivatives are of first order, in reverse mode. The functions can be compiled by jax.jit.
"""

from __future__ import annotations

from typing import Any, Callable

import jax
import numpy as np

from . import _simulate
from ._hybrid import HybridBatch, HybridEndState, HybridProblem
from ._scene import SceneLike
from ._types import Floats


def _double(array: Any) -> Floats:
    return np.asarray(array, dtype=np.float64)


def _called(compute: Callable[..., tuple[Floats, ...]], like: tuple[jax.ShapeDtypeStruct, ...], *arrays: jax.Array) -> Any:
    """What a function of numpy returns for arrays of jax, in the shapes and types of `like`."""

    def on_host(*host: Any) -> tuple[Any, ...]:
        found = compute(*map(_double, host))
        return tuple(np.asarray(one, dtype=to.dtype).reshape(to.shape) for one, to in zip(found, like))

    return jax.pure_callback(on_host, like, *arrays)


def _like(array: jax.Array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(array.shape, array.dtype)


def losses(batch: _simulate.Batch | HybridBatch) -> Callable[[jax.Array], jax.Array]:
    """Returns a function of jax: points of shape (P, ...), as batch.loss takes them, to their P losses.

    Args:
        batch: a saltus.Batch or a saltus.HybridBatch.
    """

    def losses_of(points: jax.Array) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(points.shape[:1], points.dtype)

    @jax.custom_vjp
    def function(points: jax.Array) -> jax.Array:
        (found,) = _called(lambda host: (batch.loss(host),), (losses_of(points),), points)
        return found

    def forward(points: jax.Array) -> tuple[jax.Array, jax.Array]:
        found, gradients = _called(batch.loss_and_gradient, (losses_of(points), _like(points)), points)
        return found, gradients

    def backward(gradients: jax.Array, cotangent: jax.Array) -> tuple[jax.Array]:
        return (cotangent.reshape(-1, *[1] * (gradients.ndim - 1)) * gradients,)

    function.defvjp(forward, backward)
    return function


def end_state(
    scene: SceneLike | HybridProblem, contact: Any = "event", *, precision: str = "double"
) -> Callable[..., jax.Array]:
    """Returns the final state of a scene or of a hybrid problem as a function of jax.

    That of a scene takes the initial state and the control, of shapes (B, 4) and (K, C, 2), and returns an array of shape
    (B, 4). In scenes with rotational inertia the states are (B, 6). That of a HybridProblem takes the initial state (n0,),
    the control (K, m) and the parameters (P,), and returns an array of the shape that the final state of the problem has.

    Args:
        scene: a Scene, a dict or the path of a scene file, or a HybridProblem.
        contact, precision: of a scene, as those of saltus.Simulation.
    """
    end: Any
    if isinstance(scene, HybridProblem):
        end = HybridEndState(scene)
        final_shape = end(end.initial, end.control, end.parameters).shape
    else:
        end = _simulate.EndState(scene, contact, precision=precision)
        final_shape = None

    @jax.custom_vjp
    def function(*given: jax.Array) -> jax.Array:
        like = _like(given[0]) if final_shape is None else jax.ShapeDtypeStruct(final_shape, given[0].dtype)
        (final,) = _called(lambda *host: (end(*host),), (like,), *given)
        return final

    def forward(*given: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        return function(*given), given

    def backward(given: tuple[jax.Array, ...], cotangent: jax.Array) -> Any:
        return _called(end.vjp, tuple(map(_like, given)), *given, cotangent)

    function.defvjp(forward, backward)
    return function
