"""Estimate a weight factor per sensor that accounts for errors correlated between frames.

Beta is the scale of an error, not its correlation. A stereo matcher repeats its error in every frame that sees the same
corner, so that many of its measurements carry less information than their number, by an amount that differs from sensor
to sensor. It is estimated by cross-view prediction: photometric depth in one view is predicted from measurements of the
same place in other views, by sensors in all of them, by photometric depth in those that share no image with it. The
weight factors that predict it best are the reliabilities of the sensors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from ..sensors.fusion_weights import FusionWeights
from ..sensors.noise_model import NoiseModel
from .bias_model import BiasModel
from .photometric_samples import PhotometricSamples

DEFAULT_RELIABILITY = 1 / 3  # where it cannot be estimated


@dataclass(frozen=True)
class ReliabilityParameters:
    """Constants of the estimate.

    radius_voxels: samples closer than this are of the same place; default: where it cannot be estimated; min_samples:
    predicted samples for an estimate; max_factor: reliabilities lie within 1 / max_factor to max_factor; max_pairs: of
    samples of the same place, beyond which samples are thinned; regularisation: of the logarithm towards the default;
    discretisation_voxels: added to the photometric beta in the loss.
    """

    radius_voxels: float = 0.75
    default: float = DEFAULT_RELIABILITY
    min_samples: int = 1000
    max_factor: float = 50.0
    max_pairs: int = 4_000_000
    regularisation: float = 1e-3
    discretisation_voxels: float = 0.25


@dataclass(frozen=True)
class CrossViewSamples:
    """Measurements of N points on the surface of the map, each from one view, by the S sensors and photometric depth.

    points (N, 3) metres; views (N,) numbers; offsets (N, S + 1): signed distance behind the surface, metres, NaN = no
    measurement, photometric depth last; weights (N, S + 1): fusion weights; beta (N,): of photometric depth, metres.
    """

    points: np.ndarray
    views: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray
    beta: np.ndarray


def collect_samples(
    samples: PhotometricSamples,
    noise: Mapping[str, NoiseModel],
    biases: Mapping[str, BiasModel],
    weights: FusionWeights,
    truncation_m: float,
) -> CrossViewSamples:
    """Offsets and weights at photometric samples with the current noise and bias models.

    Columns are in the order of `samples.sensors`. Measurements farther from the map than its truncation are left out.
    """
    views = np.unique(samples.view.numpy()).tolist()
    offsets, sensor_weights = [], []
    for sensor in samples.sensors:
        depth, inputs = samples.measured_by(sensor)
        inputs, model = inputs.float(), noise[sensor]
        beta = model.beta_image(depth.to(model.device), inputs.to(model.device)).cpu()
        offset = depth - biases[sensor].offset(inputs) - samples.map_depth
        offsets.append(torch.where(depth > 0, offset, torch.nan))
        weight = torch.empty_like(beta)
        for view in views:
            of_view = samples.view == view
            weight[of_view] = weights.for_sensor(beta[of_view], depth[of_view] > 0, sensor)[0]
        sensor_weights.append(weight)
    offset = torch.stack([*offsets, samples.depth - samples.map_depth], 1)
    offset[offset.abs() >= truncation_m] = torch.nan
    beta = samples.beta.float()
    weight = torch.stack([*sensor_weights, weights.inverse_variance(beta)], 1)
    used = samples.map_depth > 0
    columns = (samples.points(), samples.view, offset, weight, beta)
    return CrossViewSamples(*(values[used].numpy() for values in columns))


def estimate_reliability(
    samples: CrossViewSamples,
    dependent_views: np.ndarray,
    voxel_size_m: float,
    sensors: Sequence[str],
    parameters: ReliabilityParameters = ReliabilityParameters(),
) -> dict[str, float]:
    """By sensor, the factor on its weights with which photometric depth of a view is best predicted by other views.

    `sensors` are in the order of the columns of `samples`. dependent_views (V, V) bool: pairs of views that share an
    image, whose photometric depths do not predict each other. A factor without influence, or all of them if too few
    samples can be predicted, stay at the default.
    """
    if samples.offsets.shape[1] != len(sensors) + 1:
        raise ValueError(f"{samples.offsets.shape[1]} columns for {len(sensors)} sensors and photometric depth")
    radius_m = parameters.radius_voxels * voxel_size_m
    start = np.full(len(sensors), np.log(parameters.default))
    samples = thin_samples(samples, radius_m, parameters.max_pairs)
    weights, products = _sums_of_other_views(samples, dependent_views, radius_m)
    used = np.isfinite(samples.offsets[:, -1]) & (samples.beta < voxel_size_m)
    used &= (weights > 0).sum(1) > 1  # the factor of a sole source has no influence on its mean
    if used.sum() < parameters.min_samples:
        return dict.fromkeys(sensors, parameters.default)
    target = samples.offsets[used, -1]
    scale = np.hypot(samples.beta[used], parameters.discretisation_voxels * voxel_size_m)
    weights, products = weights[used], products[used]

    def loss(log_factors: np.ndarray) -> float:
        factors = np.append(np.exp(log_factors), 1.0)
        predicted = products @ factors / np.maximum(weights @ factors, 1e-12)
        penalty = parameters.regularisation * np.square(log_factors - start).sum()
        return float((np.abs(target - predicted) / scale).mean() + penalty)

    simplex = np.vstack([start, start - np.eye(len(start))])
    limit = math.log(parameters.max_factor)
    log_factors = minimize(
        loss,
        start,
        method="Nelder-Mead",
        bounds=[(-limit, limit)] * len(start),
        options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-6},
    ).x
    return dict(zip(sensors, np.exp(log_factors).tolist(), strict=True))


_COUNTED = 50_000  # samples by which pairs are counted: speed only


def thin_samples(samples: CrossViewSamples, radius_m: float, max_pairs: int) -> CrossViewSamples:
    """Every n-th sample, so that about `max_pairs` pairs lie within `radius_m` of each other."""
    every = 1 + len(samples.points) // _COUNTED
    tree = cKDTree(samples.points[::every])
    pairs = every**2 * (tree.count_neighbors(tree, radius_m) - tree.n) / 2
    step = max(1, math.ceil(math.sqrt(pairs / max_pairs)))
    return CrossViewSamples(*(values[::step] for values in vars(samples).values()))


def _sums_of_other_views(
    samples: CrossViewSamples, dependent_views: np.ndarray, radius_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """(N, S + 1) sums of weights and of weights times offsets at each place, over other views; for photometric depth,
    the last column, over independent ones."""
    pairs = cKDTree(samples.points).query_pairs(radius_m, output_type="ndarray")
    place, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    views = samples.views[place], samples.views[other]
    other_views = _pair_sums(place, other, views[0] != views[1], len(samples.views))
    independent = _pair_sums(place, other, ~dependent_views[views], len(samples.views))
    measured = np.isfinite(samples.offsets)
    weights = np.where(measured, samples.weights, 0.0)
    products = weights * np.where(measured, samples.offsets, 0.0)
    sums = [np.column_stack([other_views @ v[:, :-1], independent @ v[:, -1:]]) for v in (weights, products)]
    return sums[0], sums[1]


def _pair_sums(place: np.ndarray, other: np.ndarray, used: np.ndarray, count: int) -> csr_array:
    """The (count, count) matrix that sums at each place over the others that it is paired with, where `used`."""
    place, other = place[used], other[used]
    return coo_array((np.ones(len(place), np.float32), (place, other)), shape=(count, count)).tocsr()
