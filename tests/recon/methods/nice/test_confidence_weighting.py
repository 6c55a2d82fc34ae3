"""Readings weighed by confidence in the losses of the feature grids, and the method `nice-slam-pre`."""

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.config.nice import NiceConfig, NiceTrackingConfig
from uncle.recon.core.errors import ConfigError
from uncle.recon.core.frame import Frame
from uncle.recon.methods.confidence.models import ConfidenceModels, save_network
from uncle.recon.methods.confidence.network import ConfidenceNetwork
from uncle.recon.methods.nice.confidence_weighting import MIN_CONFIDENCE, ConfidenceWeighting
from uncle.recon.methods.nice.views import Rays
from uncle.recon.methods.nice.weighting import UniformWeighting
from uncle.recon.stages.map import map_run

CPU = torch.device("cpu")


@pytest.fixture
def files(tmp_path) -> list[str]:
    """Untrained networks of the sensors a and b."""
    made = []
    for seed, sensor in enumerate("ab"):
        path = tmp_path / f"{sensor}.pt"
        save_network(path, sensor, ConfidenceNetwork(torch.Generator().manual_seed(seed)), {})
        made.append(str(path))
    return made


@pytest.fixture
def weighting(files) -> ConfidenceWeighting:
    return ConfidenceWeighting(NiceConfig(), NiceTrackingConfig(), ConfidenceModels.load("ab", files), CPU)


def rays_of(depths: torch.Tensor, confidence: torch.Tensor) -> Rays:
    count = len(depths)
    return Rays(torch.zeros(count, dtype=torch.int64), torch.zeros(count, 3), depths, torch.zeros(count, 3),
                lambda: confidence[..., None], lambda: None)  # fmt: skip


def test_clues_are_the_confidences_of_each_sensor(weighting):
    depths = {"a": torch.rand(24, 32) * 3 + 0.5, "b": torch.rand(24, 32) * 3 + 0.5}
    depths["b"][4:9, 6:8] = 0.0
    frame = Frame(0, 0.0, torch.zeros(24, 32, 3, dtype=torch.uint8), depths, None)
    weighting_inputs = weighting.weighting_inputs(frame, lambda index, sensor: None)
    assert weighting_inputs.shape == (2, 1, 24, 32)
    torch.testing.assert_close(
        weighting_inputs[0, 0], weighting.models.image("a", depths["a"]).clamp(min=MIN_CONFIDENCE)
    )
    read = depths["b"] > 0
    torch.testing.assert_close(
        weighting_inputs[1, 0][read], weighting.models.image("b", depths["b"])[read].clamp(min=MIN_CONFIDENCE)
    )
    assert bool((weighting_inputs[1, 0][~read] == 1).all())


def test_mapping_weighs_each_residual_by_its_confidence_in_every_stage(weighting):
    residuals, confidence = torch.rand(7, 2), torch.rand(7, 2)
    valid = torch.rand(7, 2) < 0.7
    rays = rays_of(torch.ones(7, 2), confidence)
    expected = sum(float(confidence[n, k] * residuals[n, k]) for n in range(7) for k in range(2) if bool(valid[n, k]))
    for stage in ("middle", "fine", "color"):
        assert weighting.depth_loss(residuals, valid, rays, stage).item() == pytest.approx(expected, rel=1e-5)


def test_tracking_multiplies_by_it(weighting):
    spread, confidence = torch.rand(5) + 0.1, torch.rand(5, 2) + 0.1
    rays = rays_of(torch.ones(5, 2), confidence)
    torch.testing.assert_close(
        weighting.residual_scale(spread, rays), spread[:, None] / confidence, rtol=1e-4, atol=1e-6
    )


def test_full_confidence_is_nice_slam(weighting):
    plain = UniformWeighting(NiceConfig(), NiceTrackingConfig())
    rays, valid = rays_of(torch.ones(5, 2), torch.ones(5, 2)), torch.ones(5, 2, dtype=torch.bool)
    residuals, spread = torch.rand(5, 2), torch.rand(5)
    assert torch.equal(weighting.residual_scale(spread, rays), plain.residual_scale(spread, rays))
    assert weighting.depth_loss(residuals, valid, rays, "fine") == plain.depth_loss(residuals, valid, rays, "fine")


def settings(*overrides: str):
    quick = [
        "nice.decoders=random", "nice_mapping.every=4", "nice_mapping.first_iterations=4", "nice_mapping.iterations=2",
        "nice_mapping.pixels=100", "nice_mapping.refine=false", "fusion.voxel_size_m=0.1",
    ]  # fmt: skip
    return make_config("nice-slam-pre", [*quick, *overrides], sensors=("a", "b"), device="cpu")


def test_nice_slam_pre_maps_with_the_networks_of_files(make_mappable_run, files, tmp_path):
    run = make_mappable_run(("gt", "a", "b"), np.linspace(0, 0.3, 3))
    config = settings(f"confidence.files={files}".replace("'", '"'))
    assert not map_run(run, config).unchanged
    assert run.load_manifest().stages["map"].facts["method"] == "nice-slam-pre"
    assert map_run(run, config).unchanged
    save_network(tmp_path / "a.pt", "a", ConfidenceNetwork(torch.Generator().manual_seed(9)), {})
    assert not map_run(run, config).unchanged  # another network, another map


def test_a_sensor_without_a_network_is_named_before_anything_is_done(make_mappable_run, files):
    run = make_mappable_run(("gt", "a", "b"), np.linspace(0, 0.3, 3))
    with pytest.raises(ConfigError, match="no confidence network for the sensor 'b'"):
        map_run(run, settings(f'confidence.files=["{files[0]}"]'))
    assert "map" not in run.load_manifest().stages
