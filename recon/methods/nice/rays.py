"""Samples along rays and what they render to: pure functions (docs/uncle-paper.md, Sampling and rendering)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .decoders import OCCUPANCY_SLOPE

# Constants of the released code of NICE-SLAM and UncLe-SLAM.
NEAR_RATIO = 0.01  # of the mean depth at the pixel
FAR_RATIO = 1.2  # of the largest depth in the batch
EXIT_MARGIN_M = 0.01  # samples may lie so far outside of the box
SURFACE_BAND = 0.05  # samples around a depth lie within this ratio of it
MISSING_NEAR_M = 0.001  # where a sensor has no depth its samples begin here
TINY = 1e-10


class RenderedDepth(NamedTuple):
    """depth (N,) metres; variance (N,) metres^2; weights (N, S)."""

    depth: Tensor
    variance: Tensor
    weights: Tensor


def box_exit(origins: Tensor, directions: Tensor, bound: Tensor) -> Tensor:
    """(N, 3) origins and directions, bound (2, 3) metres -> (N,) ray parameter where each ray leaves the box."""
    safe = torch.where(directions.abs() < 1e-9, torch.full_like(directions, 1e-9), directions)
    ends = (bound[:, None] - origins) / safe
    return ends.amax(0).amin(-1)


def sample_depths(depths: Tensor, exits: Tensor, uniform: int, near_surface: int) -> Tensor:
    """Sample positions z (N, uniform + K * near_surface) along N rays, metres, ascending.

    depths (N, K) metres of K sensors, 0 = no depth; exits (N,) as of `box_exit`. `uniform` samples are linear from near
    to far, `near_surface` ones around the depth of each sensor; there is no jitter.
    """
    near = NEAR_RATIO * depths.mean(1, keepdim=True)
    far = FAR_RATIO * depths.max()
    far = torch.where(far > 0, torch.minimum(exits + EXIT_MARGIN_M, far), exits)[:, None]
    steps = torch.linspace(0.0, 1.0, uniform, device=depths.device)
    samples = [near * (1 - steps) + far * steps]
    steps = torch.linspace(0.0, 1.0, near_surface, device=depths.device)
    for sensor in range(depths.shape[1]):
        depth = depths[:, sensor, None]
        band = depth * ((1 - SURFACE_BAND) + 2 * SURFACE_BAND * steps)
        missing = MISSING_NEAR_M + (depths[:, sensor].max() - MISSING_NEAR_M) * steps
        samples.append(torch.where(depth > 0, band, missing))
    return torch.cat(samples, 1).sort(1).values


def ray_weights(logits: Tensor) -> Tensor:
    """(N, S) logits along rays, front to back -> (N, S) probability that a ray ends at a sample; sums to at most 1."""
    occupancy = torch.sigmoid(OCCUPANCY_SLOPE * logits)
    passing = torch.cumprod(1 - occupancy[:, :-1] + TINY, 1)
    return occupancy * torch.cat([torch.ones_like(passing[:, :1]), passing], 1)


def render_depth(logits: Tensor, z: Tensor) -> RenderedDepth:
    """(N, S) logits and z -> depth and variance of each ray. Weights are not normalised: nothing hit is depth 0."""
    weights = ray_weights(logits)
    depth = (weights * z).sum(1)
    return RenderedDepth(depth, (weights * (depth[:, None] - z).square()).sum(1), weights)
