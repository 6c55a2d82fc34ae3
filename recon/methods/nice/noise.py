"""h_w of UncLe-SLAM: the error scale of a depth from a 5 x 5 patch of the sensor's image (docs/uncle-paper.md)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from ...core import normals as features
from ...core.camera import Camera
from . import published_normals
from .decoders import linear_layers

# Constants of UncLe-SLAM.
PATCH = 5  # pixels
HIDDEN = 32
HIDDEN_LAYERS = 5
COLOR_INPUTS = 3


class NoiseNet(nn.Module):
    """(N, F * patch^2) values of a patch, feature by feature -> (N,) softplus(y) = beta - beta_min, metres.

    Five hidden layers of 32 with ReLU, one output: with 5 x 5 pixels 5889 parameters for F = 2, 9889 for 7, 6689 for
    colour (F = 3).
    """

    def __init__(self, inputs: int, generator: torch.Generator | None = None, patch: int = PATCH) -> None:
        super().__init__()
        sizes = [inputs * patch**2, *[HIDDEN] * HIDDEN_LAYERS, 1]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        with torch.no_grad():
            for layer in linear_layers(self.layers):
                nn.init.xavier_uniform_(layer.weight, nn.init.calculate_gain("relu"), generator=generator)
                layer.bias.zero_()

    def forward(self, patches: Tensor) -> Tensor:
        """(N, F * patch^2) -> (N,)."""
        for layer in self.layers[:-1]:
            patches = torch.relu(layer(patches))
        return softplus(self.layers[-1](patches)[..., 0])


def noise_inputs(depth: Tensor, normals: Tensor, camera: Camera, count: int, released: bool) -> Tensor:
    """Inputs (count, H, W) of h_w; 2: depth and incidence; 7: depth, normal, incidence, dx, dy.

    depth (H, W) metres, normals (H, W, 3) towards the camera. The paper's incidence is the angle between normal and
    line of sight, radians, a right angle where the normal is unknown; the released code takes the signed cosine to its
    own normals (docs/uncle-paper.md, differences 6 and 7).
    """
    metres = depth.numpy()
    gradients: tuple[np.ndarray, ...] = ()
    if released:
        smooth = published_normals.smooth_depth(metres)
        normal = published_normals.normals(smooth, camera).astype(np.float32)
        incidence = published_normals.incidence(normal, camera).astype(np.float32)
        gradients = published_normals.gradients(metres)
    else:
        normal = normals.numpy()
        incidence = np.arccos(features.incidence(normal, camera)).astype(np.float32)
        if count == 7:
            gradients = features.gradients(metres)
    planes = [metres, incidence] if count == 2 else [metres, *np.moveaxis(normal, -1, 0), incidence, *gradients]
    return torch.from_numpy(np.stack(planes).astype(np.float32, copy=False))


def gather_patches(images: Tensor, frames: Tensor, rows: Tensor, columns: Tensor, size: int = PATCH) -> Tensor:
    """images (K, ..., C, H, W); frames, rows, columns (N,) -> (N, ..., C * size^2) of the pixels around each.

    Feature by feature. Beyond the border the image continues on its other side, as a cyclic shift of it would.
    """
    height, width = images.shape[-2:]
    offsets = torch.arange(size, device=images.device) - size // 2
    down = ((rows[:, None] + offsets) % height)[:, :, None]
    across = ((columns[:, None] + offsets) % width)[:, None, :]
    pixels = (down * width + across).view(len(rows), -1)
    flat = images.reshape(len(images), -1, height * width)
    patches = flat[frames[:, None, None], torch.arange(flat.shape[1], device=flat.device)[:, None], pixels[:, None]]
    return patches.reshape(len(rows), *images.shape[1:-3], -1)
