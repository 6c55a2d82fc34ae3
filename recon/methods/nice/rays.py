"""Where a ray is sampled, and what its samples amount to: pure functions (METHOD, Ray sampling and rendering)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .decoders import OCCUPANCY_SLOPE

NEAR = 0.01  # of the mean depth at the pixel
FAR = 1.2  # of the farthest reading in the batch
BAND = 0.05  # samples around a reading lie within this share of it
EMPTY_NEAR_M = 0.001  # where a sensor reads nothing its samples begin here
TINY = 1e-10


class Rendered(NamedTuple):
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
    """depths (N, K) metres of K sensors, 0 = no reading; exits (N,) -> z (N, uniform + K * near_surface), ascending.

    `uniform` ones from near to far, and `near_surface` ones around each reading; no jitter.
    """
    near = NEAR * depths.mean(1, keepdim=True)
    far = FAR * depths.max()
    far = torch.where(far > 0, torch.minimum(exits + 0.01, far), exits)[:, None]
    steps = torch.linspace(0.0, 1.0, uniform, device=depths.device)
    samples = [near * (1 - steps) + far * steps]
    steps = torch.linspace(0.0, 1.0, near_surface, device=depths.device)
    for sensor in range(depths.shape[1]):
        reading = depths[:, sensor, None]
        band = reading * ((1 - BAND) + 2 * BAND * steps)
        empty = EMPTY_NEAR_M + (depths[:, sensor].max() - EMPTY_NEAR_M) * steps
        samples.append(torch.where(reading > 0, band, empty))
    return torch.cat(samples, 1).sort(1).values


def ray_weights(logits: Tensor) -> Tensor:
    """(N, S) logits along rays, front to back -> (N, S) probability that a ray ends at a sample; sums to at most 1."""
    occupancy = torch.sigmoid(OCCUPANCY_SLOPE * logits)
    passing = torch.cumprod(1 - occupancy[:, :-1] + TINY, 1)
    return occupancy * torch.cat([torch.ones_like(passing[:, :1]), passing], 1)


def render(logits: Tensor, z: Tensor) -> Rendered:
    """(N, S) logits and z -> depth and variance of each ray. Weights are not renormalised: nothing hit is depth 0."""
    weights = ray_weights(logits)
    depth = (weights * z).sum(1)
    return Rendered(depth, (weights * (depth[:, None] - z).square()).sum(1), weights)
