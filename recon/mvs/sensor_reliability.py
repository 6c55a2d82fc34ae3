"""What a reading of each sensor is worth beside one of colour, found by predicting what colour says.

Beta says how far a reading is off, not how often readings are off together. A stereo matcher repeats its error in every
frame that sees the same corner, so many of its readings are worth less than their number, and by how much differs from
sensor to sensor. Colour can tell: what it says in one view is to be predicted from what is said of the same place in
other views, by sensors in all of them, by colour in those that have no image in common with it. The factors on the
weights of the sensors that predict it best are what their readings are worth.
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
from .photometric_depth import PhotometricDepth

PLACE_VOXELS = 0.75  # readings this near to each other are of the same place
DEFAULT_RELIABILITY = 1 / 3  # where it cannot be found
ENOUGH = 1000  # predicted readings
FARTHEST = 50.0  # from 1: less or more cannot be told from nothing or everything
MAX_PAIRS = 4_000_000  # of readings of the same place; where there are more, fewer readings are asked
_COUNTED = 50_000  # readings by which pairs are counted
_PULL = 1e-3  # of the logarithm towards the start, where nothing is said either way


@dataclass(frozen=True)
class CrossViewSamples:
    """What is said of points (N, 3) metres on the surface of the map, each from a view (N,).

    offsets, weights (N, S + 1): how far beyond the surface sensors and, last, colour see it, metres, not finite where
    they say nothing; and what that weighs. beta (N,): of colour there, metres.
    """

    points: np.ndarray
    views: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray
    beta: np.ndarray


def statements(
    witness: PhotometricDepth,
    noise: Mapping[str, NoiseModel],
    biases: Mapping[str, BiasModel],
    weights: FusionWeights,
    truncation_m: float,
) -> CrossViewSamples:
    """What the witness heard of points on the map, with the uncertainty, biases and weights of the sensors as they are
    now; readings farther from the map than its truncation say nothing."""
    told, offsets, weighs = witness.samples, [], []
    views = told["views"].unique().tolist()
    for column, (sensor, model) in enumerate(noise.items()):
        depth, inputs = told["sensors"][:, column], told["inputs"][:, column].float()
        beta = model.beta_image(depth.to(model.device), inputs.to(model.device)).cpu()
        offset = depth - biases[sensor].of(inputs) - told["expected"]
        offsets.append(torch.where(depth > 0, offset, torch.nan))
        weight = torch.empty_like(beta)
        for view in views:
            of_view = told["views"] == view
            weight[of_view] = weights.for_sensor(beta[of_view], depth[of_view] > 0, sensor)[0]
        weighs.append(weight)
    offset = torch.stack([*offsets, told["color"] - told["expected"]], 1)
    offset[offset.abs() >= truncation_m] = torch.nan
    weight = torch.stack([*weighs, weights.of(told["beta"].float())], 1)
    seen = told["expected"] > 0
    columns = (witness.points(), told["views"], offset, weight, told["beta"].float())
    return CrossViewSamples(*(values[seen].numpy() for values in columns))


def estimate_reliability(
    said: CrossViewSamples, related: np.ndarray, voxel_size_m: float, sensors: Sequence[str]
) -> dict[str, float]:
    """By sensor, the factor on its weights with which colour of each view is best predicted by other views.

    related (V, V) bool: views with an image in common, whose colours predict nothing of each other. Where it makes no
    difference, or colour says too little that can be predicted, a reading is worth `DEFAULT_RELIABILITY`.
    """
    first = np.full(len(sensors), np.log(DEFAULT_RELIABILITY))
    said = _thinned(said, PLACE_VOXELS * voxel_size_m)
    weights, sums = _sums_of_others(said, related, PLACE_VOXELS * voxel_size_m)
    known = np.isfinite(said.offsets[:, -1]) & (said.beta < voxel_size_m)
    known &= (weights > 0).sum(1) > 1  # where one alone speaks, its factor makes no difference
    if known.sum() < ENOUGH:
        return dict.fromkeys(sensors, DEFAULT_RELIABILITY)
    wanted, scale = said.offsets[known, -1], np.hypot(said.beta[known], 0.25 * voxel_size_m)
    weights, sums = weights[known], sums[known]

    def loss(logarithms: np.ndarray) -> float:
        factors = np.append(np.exp(logarithms), 1.0)
        predicted = sums @ factors / np.maximum(weights @ factors, 1e-12)
        pull = _PULL * np.square(logarithms - first).sum()
        return float((np.abs(wanted - predicted) / scale).mean() + pull)

    corners = np.vstack([first, first - np.eye(len(first))])
    options = {"initial_simplex": corners, "xatol": 0.02, "fatol": 1e-6}
    limits = [(-np.log(FARTHEST), np.log(FARTHEST))] * len(first)
    best = minimize(loss, first, method="Nelder-Mead", bounds=limits, options=options).x
    return dict(zip(sensors, np.exp(best).tolist(), strict=True))


def _thinned(said: CrossViewSamples, radius_m: float) -> CrossViewSamples:
    """So few of the statements that there are about `MAX_PAIRS` within `radius_m` of each other."""
    few = 1 + len(said.points) // _COUNTED
    tree = cKDTree(said.points[::few])
    pairs = few**2 * (tree.count_neighbors(tree, radius_m) - tree.n) / 2
    step = max(1, math.ceil(math.sqrt(pairs / MAX_PAIRS)))
    return CrossViewSamples(*(values[::step] for values in vars(said).values()))


def _sums_of_others(said: CrossViewSamples, related: np.ndarray, radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, S + 1) weights, and weights times offsets, of what other views say of each place; for colour, last, those
    that are not related."""
    near = cKDTree(said.points).query_pairs(radius_m, output_type="ndarray")
    place, other = np.concatenate([near, near[:, ::-1]]).T
    views = said.views[place], said.views[other]
    others, independent = (_sum_over(place[m], other[m], said) for m in (views[0] != views[1], ~related[views]))
    there = np.isfinite(said.offsets)
    weights = np.where(there, said.weights, 0.0)
    products = weights * np.where(there, said.offsets, 0.0)
    return tuple(np.column_stack([others @ v[:, :-1], independent @ v[:, -1:]]) for v in (weights, products))


def _sum_over(place: np.ndarray, other: np.ndarray, said: CrossViewSamples) -> csr_array:
    """The (N, N) matrix that sums over the others that each place is paired with."""
    return coo_array((np.ones(len(place), np.float32), (place, other)), shape=(len(said.views),) * 2).tocsr()
