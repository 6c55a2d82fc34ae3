"""Small motions of the camera: the exponential of se(3), differentiable at zero."""

from __future__ import annotations

import torch
from torch import Tensor


def rotation(vector: Tensor) -> Tensor:
    """Axis times angle (3,), radians -> (3, 3) rotation (Rodrigues)."""
    square = vector.square().sum()
    small = square < 1e-8
    safe = torch.where(small, torch.ones_like(square), square)
    angle = safe.sqrt()
    first = torch.where(small, 1 - square / 6, torch.sin(angle) / angle)
    second = torch.where(small, 0.5 - square / 24, (1 - torch.cos(angle)) / safe)
    x, y, z = vector.unbind()
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
    return torch.eye(3, device=vector.device) + first * cross + second * (cross @ cross)


def moved(T_world_camera: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
    """(4, 4) moved by (6,): 3 of translation, metres, in world axes, 3 of rotation, radians, about the camera's centre.

    Returns rotation (3, 3) and centre (3,) of the moved camera.
    """
    return rotation(motion[3:]) @ T_world_camera[:3, :3], T_world_camera[:3, 3] + motion[:3]
