"""What the tracker takes from a frame: depth and its certainty at the features, and readings for the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import TrackingConfig
from ..core.frame import Frame
from ..sensors.noise_model import NoiseModel
from .frame_to_frame import SurfaceView
from .frame_to_model import Readings
from .landmarks import NONE, FrameFeatures
from .local_features import LocalFeatures, extract_features, no_features

EDGE_SHARE = 0.5  # of the spread of depth around a feature that adds to its sigma
DEFAULT_BETA = (
    0.005,
    0.01,
)  # beta before a sensor is known: a + b depth^2, metres; between a Kinect and a stereo matcher
VIEW_PIXELS = 19_200  # of a keyframe's picture of the surface
_GREY = torch.tensor([0.299, 0.587, 0.114]) / 255


def observe_features(
    frame: Frame,
    features: LocalFeatures,
    noise_features: dict[str, Tensor],
    noise: Sequence[NoiseModel | None],
    camera: Camera,
    common_px: float = 0.0,
) -> FrameFeatures:
    """The features with the depth readings of all sensors there. The pose is not known yet."""
    limit = [camera.width - 1, camera.height - 1]
    u, v = np.clip(np.rint(features.uv), 0, limit).astype(np.int64).T
    depths, edges, inputs = [], [], []
    for sensor, image in frame.depths.items():
        depth = image.numpy()
        depths.append(depth[v, u].astype(np.float64))
        edges.append(_spread(depth)[v, u])
        inputs.append(noise_features[sensor].numpy()[v, u] if sensor in noise_features else np.zeros((len(u), 0)))
    frame_features = FrameFeatures(
        frame.index, np.eye(4), features.uv, features.sigma_px, np.stack(depths, 1), np.zeros((len(u), len(depths))),
        np.stack(edges, 1), np.stack(inputs, 1).astype(np.float32), np.full(len(u), NONE),
        common_px,
    )  # fmt: skip
    weigh(frame_features, noise)
    return frame_features


def weigh(frame_features: FrameFeatures, noise: Sequence[NoiseModel | None]) -> None:
    """Set the sigmas of the depths by what the models of the sensors know now.

    A Laplace scale beta is a standard deviation of sqrt(2) beta; a feature beside a depth edge may lie on either side.
    """
    for column, model in enumerate(noise):
        depth = torch.from_numpy(frame_features.depths[:, column]).float()
        beta = _beta(depth, torch.from_numpy(frame_features.noise[:, column]), model).numpy()
        frame_features.sigmas_m[:, column] = np.hypot(math.sqrt(2) * beta, EDGE_SHARE * frame_features.edges[:, column])


@dataclass(frozen=True)
class Prepared:
    """What can be made of a frame beforehand: its features, and by sensor every `stride`-th normal (h, w, 3)."""

    features: LocalFeatures
    normals: dict[str, np.ndarray]
    stride: int


def prepare(frame: Frame, normals: dict[str, Tensor], camera: Camera, config: TrackingConfig) -> Prepared:
    """Features (none without colour) and thinned-out normals."""
    features = extract_features(frame.color.numpy(), config.features) if config.color else no_features()
    stride = max(1, round(math.sqrt(camera.width * camera.height / VIEW_PIXELS)))
    return Prepared(features, {s: n[::stride, ::stride].numpy() for s, n in normals.items()}, stride)


def surface_view(
    frame: Frame,
    prepared: Prepared,
    noise_features: dict[str, Tensor],
    noise: Sequence[NoiseModel | None],
    camera: Camera,
    max_depth_m: float,
) -> SurfaceView:
    """The surface as the frame sees it; of several sensors the most certain one at each pixel."""
    grid = (slice(None, None, prepared.stride), slice(None, None, prepared.stride))
    depths, sigmas = [], []
    for (sensor, image), model in zip(frame.depths.items(), noise, strict=True):
        depth = image[grid]
        inputs = noise_features[sensor][grid].reshape(depth.numel(), -1) if sensor in noise_features else None
        spread = math.sqrt(2) * _beta(depth.reshape(-1), inputs, model).view(depth.shape).numpy()
        usable = ((depth > 0) & (depth < max_depth_m)).numpy() & (np.abs(prepared.normals[sensor]).sum(-1) > 0)
        depths.append(depth.numpy())
        sigmas.append(np.where(usable, spread, np.inf))
    best = np.argmin(sigmas, axis=0)[None]
    depth, sigma = (np.take_along_axis(np.stack(images), best, 0)[0] for images in (depths, sigmas))
    normal = np.take_along_axis(np.stack([prepared.normals[s] for s in frame.depths]), best[..., None], 0)[0]
    thinned = camera.strided(prepared.stride)
    return SurfaceView(thinned, thinned.rays().numpy() * depth[..., None], normal, sigma)


def sample_depth_points(
    frame: Frame,
    noise_features: dict[str, Tensor],
    noise: Sequence[NoiseModel | None],
    camera: Camera,
    config: TrackingConfig,
    max_depth_m: float,
) -> Readings:
    """About `config.depth_samples` depth readings of each sensor, on a regular grid of pixels."""
    stride = max(1, round(math.sqrt(camera.width * camera.height / config.depth_samples)))
    grid = (slice(stride // 2, None, stride), slice(stride // 2, None, stride))
    rays, points, betas = camera.rays()[grid], [], []
    grey = cv2.blur(frame.color.numpy(), (5, 5)) if config.color else None  # about what a voxel averages
    shades = []
    for (sensor, image), model in zip(frame.depths.items(), noise, strict=True):
        depth = image[grid]
        valid = (depth > 0) & (depth < max_depth_m)
        inputs = noise_features[sensor][grid][valid] if sensor in noise_features else None
        points.append(rays[valid] * depth[valid, None])
        betas.append(_beta(depth[valid], inputs, model))
        if grey is not None:
            shades.append(torch.from_numpy(grey[grid]).float()[valid] @ _GREY)
    joined = torch.cat(points)
    directions = joined / joined[:, 2:].clamp(min=1e-6)
    return Readings(joined, directions, torch.cat(betas), torch.cat(shades) if shades else None)


def default_beta(depth: Tensor) -> Tensor:
    """depth (N,) metres -> beta (N,) metres of a sensor that is not known."""
    return DEFAULT_BETA[0] + DEFAULT_BETA[1] * depth**2


@torch.no_grad()
def _beta(depth: Tensor, inputs: Tensor | None, model: NoiseModel | None) -> Tensor:
    """depth (N,) metres and inputs (N, F) -> beta (N,) metres."""
    if model is None or inputs is None or not model.is_trained:
        return default_beta(depth)
    device = next(model.parameters()).device
    beta: Tensor = model(inputs.to(device)).cpu()
    return beta


def _spread(depth: np.ndarray) -> np.ndarray:
    """(H, W) metres -> difference of the largest and the smallest reading around each pixel."""
    ones = np.ones((7, 7), np.uint8)
    largest = cv2.dilate(depth, ones)
    smallest = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), ones)
    return np.where(depth > 0, largest - smallest, np.float32(0.0))
