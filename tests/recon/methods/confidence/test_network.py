"""The confidence network: its size, its arithmetic, and its files."""

import numpy as np
import pytest
import torch
from torch.nn.functional import interpolate, max_pool2d, pad
from uncle.recon.core.errors import ConfigError
from uncle.recon.methods.confidence.models import ConfidenceModels, save_network, shipped_sensors
from uncle.recon.methods.confidence.network import PARAMETERS, ConfidenceNetwork, confidence_image


@pytest.fixture(scope="module")
def network() -> ConfidenceNetwork:
    return ConfidenceNetwork(torch.Generator().manual_seed(3))


def plain_convolution(layer, image: torch.Tensor) -> torch.Tensor:
    """3 x 3, reflected at the border, then ReLU: as nine shifted products."""
    padded = pad(image[None], (1, 1, 1, 1), mode="reflect")[0]
    height, width = image.shape[1:]
    total = layer.bias[:, None, None].expand(-1, height, width).clone()
    for y in range(3):
        for x in range(3):
            shifted = padded[:, y : y + height, x : x + width]
            total += torch.einsum("oi,ihw->ohw", layer.weight[:, :, y, x], shifted)
    return total.clamp(min=0)


def test_it_has_the_parameters_of_routed_fusions_network_without_its_depth_head(network):
    assert sum(values.numel() for values in network.parameters()) == PARAMETERS == 370_241


@pytest.mark.parametrize("shape", [(12, 16), (13, 17)])
@torch.no_grad()
def test_it_computes_what_the_listed_layers_compute(network, shape):
    depth = torch.rand(1, *shape, generator=torch.Generator().manual_seed(0)) * 4
    fine = plain_convolution(network.pre[2], plain_convolution(network.pre[0], depth))
    half = max_pool2d(fine[None], 3, 2, 1)[0]
    coarse = plain_convolution(network.process[2], plain_convolution(network.process[0], half))
    doubled = interpolate(coarse[None], scale_factor=2, mode="bilinear")[0][:, : shape[0], : shape[1]]
    joined = torch.cat([fine, doubled])
    expected = plain_convolution(network.head[2], plain_convolution(network.head[0], joined))
    torch.testing.assert_close(network(depth[None])[0], expected, atol=1e-4, rtol=1e-4)


def test_no_reading_has_no_confidence(network):
    depth = torch.full((20, 24), 2.0)
    depth[5:9, 3:7] = 0.0
    image = confidence_image(network, depth)
    assert image.shape == depth.shape
    assert bool((image[depth == 0] == 0).all())
    assert bool(((image[depth > 0] > 0) & (image[depth > 0] <= 1)).all())


def test_a_file_gives_the_network_back(network, tmp_path):
    save_network(tmp_path / "mine.pt", "mine", network, {"steps": 1})
    loaded = ConfidenceModels.load(["mine"], [tmp_path / "mine.pt"])
    depth = torch.rand(24, 24) * 3
    torch.testing.assert_close(loaded.image("mine", depth), confidence_image(network, depth), atol=2e-3, rtol=0)
    assert (tmp_path / "mine.pt").stat().st_size < 800_000


def test_other_weights_have_another_digest(network, tmp_path):
    save_network(tmp_path / "a.pt", "mine", network, {})
    save_network(tmp_path / "b.pt", "mine", ConfidenceNetwork(torch.Generator().manual_seed(4)), {})
    digests = [ConfidenceModels.load(["mine"], [tmp_path / name]).digest for name in ("a.pt", "b.pt", "a.pt")]
    assert digests[0] == digests[2] != digests[1]


def test_broken_files_are_named(tmp_path):
    broken = tmp_path / "broken.pt"
    broken.write_bytes(b"no network")
    with pytest.raises(ConfigError, match=r"broken\.pt: not a file of `uncle pretrain confidence`"):
        ConfidenceModels.load(["mine"], [broken])
    torch.save({"format": "uncle confidence network", "version": 1, "weights": {"a": torch.ones(1)}}, broken)
    with pytest.raises(ConfigError, match="damaged"):
        ConfidenceModels.load(["mine"], [broken])
    torch.save({"format": "uncle confidence network", "version": 7}, broken)
    with pytest.raises(ConfigError, match="format 7, here 1"):
        ConfidenceModels.load(["mine"], [broken])
    with pytest.raises(ConfigError, match="there is no"):
        ConfidenceModels.load(["mine"], [tmp_path / "nothing.pt"])


def test_an_unknown_sensor_names_the_command_that_trains_one():
    with pytest.raises(ConfigError, match="uncle pretrain confidence DATASET --sensor radar"):
        ConfidenceModels.load(["radar"])


def test_networks_that_come_with_the_package_are_right_about_a_wrong_reading():
    """A spike of two metres in a plain wall is not trusted more than the wall around it; of stereo, less."""
    sensors = shipped_sensors()
    if not sensors:
        pytest.skip("no weights are shipped")
    depth = torch.from_numpy(np.full((96, 96), 2.0, np.float32))
    depth[40:48, 40:48] = 4.0
    for sensor in sensors:
        image = ConfidenceModels.load([sensor]).image(sensor, depth)
        spike, wall = float(image[40:48, 40:48].mean()), float(image[10:30, 10:30].mean())
        assert spike <= wall, sensor
        assert spike < 0.8 * wall or sensor == "sl"  # whose errors lie below the penalty: all of it is trusted
