"""Frames as mapper and tracker take them, and rays through their pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from ...core.camera import Camera
from .noise import gather_patches


@dataclass(frozen=True)
class PreparedFrame:
    """A frame of K sensors as stacked tensors.

    depths (K, H, W) metres, 0 = no depth; color (H, W, 3) uint8; weighting_inputs (K, C, H, W) as of
    `Weighting.weighting_inputs`, C may be 0.
    """

    index: int
    depths: Tensor
    color: Tensor
    weighting_inputs: Tensor

    def to(self, device: torch.device) -> PreparedFrame:
        """The same on a device."""
        return PreparedFrame(
            self.index, *(part.to(device) for part in (self.depths, self.color, self.weighting_inputs))
        )


@dataclass(frozen=True)
class Rays:
    """N rays of M frames.

    views (N,) the frame of each; directions (N, 3) in camera axes, with z = 1; depths (N, K) metres; colors (N, 3) in
    0..1. The weighting's inputs are gathered at their first use: the middle stage needs none.
    """

    views: Tensor
    directions: Tensor
    depths: Tensor
    colors: Tensor
    gather_inputs: Callable[[], Tensor]
    gather_colors: Callable[[], Tensor]

    @cached_property
    def weighting_inputs(self) -> Tensor:
        """(N, K, C * patch_size^2)."""
        return self.gather_inputs()

    @cached_property
    def color_patches(self) -> Tensor:
        """(N, 3 * color_patch^2) in 0..1, for a weighting with a colour patch."""
        return self.gather_colors()

    def posed(self, T_world_camera: Tensor) -> tuple[Tensor, Tensor]:
        """Poses (M, 4, 4) -> origins and directions (N, 3) in the world."""
        rotations, centres = T_world_camera[:, :3, :3], T_world_camera[:, :3, 3]
        return centres[self.views], torch.einsum("nij,nj->ni", rotations[self.views], self.directions)


class Window:
    """Frames side by side, from which rays are drawn; `edge` pixels at their border are cut away."""

    def __init__(
        self, views: list[PreparedFrame], camera: Camera, patch_size: int, color_patch: int, edge: int = 0
    ) -> None:
        """patch_size, color_patch: sides of the patches that the weighting uses, pixels; 0: no colour patch."""
        self.camera, self.patch_size, self.color_patch = camera.cropped(edge), patch_size, color_patch
        inner = (slice(edge, camera.height - edge), slice(edge, camera.width - edge))
        self.depths = torch.stack([view.depths[:, *inner] for view in views])
        self.colors = torch.stack([view.color[inner] for view in views])
        self.weighting_inputs = torch.stack([view.weighting_inputs[:, :, *inner] for view in views])
        self.planes = self.colors.permute(0, 3, 1, 2).contiguous() if color_patch else self.colors
        self.count = len(views)

    def draw(self, pixels: int, generator: torch.Generator) -> Rays:
        """`pixels` rays, evenly many of each frame, at random with replacement; generator on the frames' device."""
        each, device = max(1, pixels // self.count), self.depths.device
        height, width = self.depths.shape[-2:]
        picks = torch.randint(height * width, (self.count * each,), generator=generator, device=device)
        views = torch.arange(self.count, device=device).repeat_interleave(each)
        return self.at(views, picks // width, picks % width)

    def at(self, views: Tensor, rows: Tensor, columns: Tensor) -> Rays:
        """The rays of pixels (N,) of frames (N,)."""
        x, y = self.camera.unproject(columns, rows)
        depths = self.depths[views, :, rows, columns]
        directions = torch.stack([x, y, torch.ones_like(x)], -1)
        pixels = (views, rows, columns)
        return Rays(
            views, directions, depths, self.colors[pixels].float() / 255,
            lambda: gather_patches(self.weighting_inputs, *pixels, self.patch_size),
            lambda: gather_patches(self.planes, *pixels, self.color_patch).float() / 255,
        )  # fmt: skip
