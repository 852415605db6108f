"""Motions and losses as functions of torch, with exact derivatives.

    >>> import torch, saltus.torch
    >>> end = saltus.torch.EndState("problems/two_balls.yaml", "event")
    >>> control = end.control.requires_grad_()
    >>> end(end.initial, control)[1, :2].square().sum().backward()
    >>> control.grad.shape
    torch.Size([480, 1, 2])

Everything is computed in double precision, on the CPU; float tensors are converted, and so are their gradients.
Derivatives are of first order.
"""

from __future__ import annotations

from typing import Any, Callable

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from . import _simulate
from ._hybrid import HybridBatch, HybridEndState, HybridProblem
from ._scene import SceneLike
from ._types import Floats


def _numpy(tensor: torch.Tensor) -> Floats:
    return np.asarray(tensor.detach().cpu().to(torch.float64).numpy())


def _like(array: Floats, tensor: torch.Tensor) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array)).to(dtype=tensor.dtype, device=tensor.device)


class _EndState(torch.autograd.Function):
    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, end: _simulate.EndState | HybridEndState, *given: torch.Tensor
    ) -> torch.Tensor:
        ctx.end = end
        ctx.save_for_backward(*given)
        return _like(end(*map(_numpy, given)), given[0])

    @staticmethod
    @once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, cotangent: torch.Tensor) -> Any:
        given = ctx.saved_tensors
        found = ctx.end.vjp(*map(_numpy, given), _numpy(cotangent))
        return None, *map(_like, found, given)


class EndState:
    """The final state of a scene under a contact model, as a function of torch.

    ``end(initial, control)`` takes tensors of shapes (B, 4) and (K, C, 2) and returns one of shape (B, 4). In scenes with
    rotational inertia the states are (B, 6).

    Args:
        scene, contact, precision: as those of saltus.Simulation.
    """

    def __init__(self, scene: SceneLike, contact: Any = "event", *, precision: str = "double"):
        self._end = _simulate.EndState(scene, contact, precision=precision)

    @property
    def initial(self) -> torch.Tensor:
        """The initial state of the scene, as a new tensor."""
        return torch.from_numpy(self._end.initial)

    @property
    def control(self) -> torch.Tensor:
        """The initial control of the scene, as a new tensor."""
        return torch.from_numpy(self._end.control)

    def __call__(self, initial: torch.Tensor, control: torch.Tensor) -> torch.Tensor:
        final: torch.Tensor = _EndState.apply(self._end, initial, control)
        return final


def end_state(problem: HybridProblem) -> Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]:
    """Returns the final state of a hybrid problem as a function of torch: of the initial state (n0,), the control (K, m) and
    the parameters (P,)."""
    end = HybridEndState(problem)

    def function(initial: torch.Tensor, control: torch.Tensor, parameters: torch.Tensor) -> torch.Tensor:
        final: torch.Tensor = _EndState.apply(end, initial, control, parameters)
        return final

    return function


class _Losses(torch.autograd.Function):
    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, points: torch.Tensor, batch: _simulate.Batch | HybridBatch
    ) -> torch.Tensor:
        losses, gradients = batch.loss_and_gradient(_numpy(points))
        ctx.save_for_backward(_like(gradients.reshape(points.shape), points))
        return _like(losses, points)

    @staticmethod
    @once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, cotangent: torch.Tensor) -> Any:
        (gradients,) = ctx.saved_tensors
        return cotangent.reshape(-1, *[1] * (gradients.dim() - 1)) * gradients, None


def losses(batch: _simulate.Batch | HybridBatch) -> Callable[[torch.Tensor], torch.Tensor]:
    """Returns a function of torch: points of shape (P, ...), as batch.loss takes them, to their P losses.

    Args:
        batch: a saltus.Batch or a saltus.HybridBatch.
    """

    def function(points: torch.Tensor) -> torch.Tensor:
        found: torch.Tensor = _Losses.apply(points, batch)
        return found

    return function


class _Loss(torch.autograd.Function):
    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, z: torch.Tensor, simulation: _simulate.Simulation
    ) -> torch.Tensor:
        loss, gradient = simulation.loss_and_gradient(_numpy(z))
        ctx.save_for_backward(_like(gradient, z))
        return z.new_tensor(loss)

    @staticmethod
    @once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, cotangent: torch.Tensor) -> Any:
        (gradient,) = ctx.saved_tensors
        return cotangent * gradient, None


def loss(simulation: _simulate.Simulation, z: torch.Tensor) -> torch.Tensor:
    """Returns the loss of the scene at the decision variables z, of shape ``simulation.shape`` or flat."""
    found: torch.Tensor = _Loss.apply(z, simulation)
    return found
