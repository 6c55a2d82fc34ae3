"""SenFuNet's parts against slow plain versions: networks, running means, blending, files."""

import numpy as np
import pytest
import torch
from torch.nn.functional import conv2d, conv3d, pad
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import ConfigError
from uncle.recon.methods.registry import method_spec
from uncle.recon.methods.senfunet.blending import believed, fused_distance, weighting_inputs
from uncle.recon.methods.senfunet.bricks import brick_samples, inner_part
from uncle.recon.methods.senfunet.models import SHIPPED, SenfunetModel, shipped_pairs
from uncle.recon.methods.senfunet.network import HALO, PARAMETERS, FeatureNetwork, WeightingNetwork
from uncle.recon.methods.senfunet.sensor_grid import BORDER_PX, MAX_WEIGHT, SensorGrid, ray_samples

GENERATOR = torch.Generator().manual_seed(0)


def count(network) -> int:
    return sum(values.numel() for values in network.parameters())


def test_the_weighting_network_has_the_parameters_of_the_reference():
    assert count(WeightingNetwork()) == PARAMETERS == 22_529


@pytest.mark.parametrize(("color", "parameters"), [(False, 960), (True, 1050)])
def test_a_feature_network_has_about_a_thousand(color, parameters):
    assert count(FeatureNetwork(color)) == parameters


@torch.no_grad()
def test_features_are_the_listed_layers_of_unit_length_and_the_depth():
    network = FeatureNetwork(True, torch.Generator().manual_seed(1))
    depth, color = torch.rand(1, 1, 9, 11) * 3, torch.rand(1, 3, 9, 11)
    values = torch.cat([depth, color], 1)
    for block in network.blocks:
        inner = values
        for layer in (block.first, block.second):
            inner = torch.tanh(conv2d(pad(inner, (1, 1, 1, 1), mode="replicate"), layer.weight, layer.bias))
        kept = values if values.shape[1] == 3 else conv2d(values, block.around.weight, block.around.bias)
        values = kept + inner
    found = network(depth, color)
    torch.testing.assert_close(found[:, :3], values / values.norm(dim=1, keepdim=True), atol=1e-5, rtol=1e-5)
    assert torch.equal(found[:, 3:], depth)


@torch.no_grad()
def test_a_share_depends_on_two_samples_around_and_not_on_the_brick():
    """Bricks with a halo give what one convolution of the whole space gives."""
    network = WeightingNetwork(torch.Generator().manual_seed(2))
    space = torch.rand(1, 10, 24, 12, 12, generator=torch.Generator().manual_seed(3))
    layers = network.layers
    plain = conv3d(space, layers[0].weight, layers[0].bias).relu()
    plain = conv3d(plain, layers[2].weight, layers[2].bias).relu()
    plain = torch.sigmoid(conv3d(plain, layers[4].weight, layers[4].bias))[:, 0]
    halves = [network(space[:, :, :14]), network(space[:, :, 10:])]
    torch.testing.assert_close(torch.cat(halves, 1), plain, atol=1e-6, rtol=1e-5)
    assert plain.shape[1] == 24 - 2 * HALO


def test_bricks_tile_the_samples():
    samples = brick_samples(torch.tensor([[0, 0, 0], [1, 0, -1]]))
    assert samples.shape == (2, 20, 20, 20, 3)
    inner = inner_part(samples)
    assert inner[0, 0, 0, 0].tolist() == [0, 0, 0]
    assert inner[1, 0, 0, 0].tolist() == [16, 0, -16]
    assert inner[1, -1, -1, -1].tolist() == [31, 15, -1]


def test_points_on_a_ray_are_one_voxel_apart_from_five_before_to_three_behind():
    camera = Camera(40, 40, 30.0, 30.0, 19.5, 19.5)
    depth = torch.zeros(40, 40)
    depth[22, 13] = 1.7
    depth[2, 20] = 1.7  # too near to the border
    T = torch.eye(4)
    T[:3, 3] = torch.tensor([0.3, -0.2, 0.1])
    samples = ray_samples(depth, camera.rays(), T, 0.05, before=5)
    assert samples.pixels.tolist() == [22 * 40 + 13]
    direction = np.array([(13 - 19.5) / 30, (22 - 19.5) / 30, 1.0])
    reading = direction * 1.7 + np.array([0.3, -0.2, 0.1])
    for position, step in enumerate(range(-5, 4)):
        point = reading + 0.05 * step * direction / np.linalg.norm(direction)
        assert samples.voxels[0, position].tolist() == np.rint(point / 0.05).astype(int).tolist()
        assert float(samples.sdf[position]) == pytest.approx(-0.05 * step, abs=1e-6)
    assert BORDER_PX == 10


def test_running_means_are_those_of_all_readings_ever():
    rng = np.random.default_rng(0)
    grid, seen = SensorGrid(6), {row: [] for row in range(6)}
    for _ in range(4):
        rows = rng.integers(-1, 5, (7, 3))
        sdf, features = rng.normal(size=3).astype(np.float32), rng.normal(size=(7, 4)).astype(np.float32)
        for reading in range(7):
            for point in range(3):
                if rows[reading, point] >= 0:
                    seen[rows[reading, point]].append((sdf[point], *features[reading]))
        grid.apply(grid.with_measurements(*map(torch.from_numpy, (rows, sdf, features))))
    for row, values in seen.items():
        assert float(grid.weight[row]) == len(values)
        expected = np.mean(values, 0) if values else np.zeros(5)
        np.testing.assert_allclose(grid.tsdf[row], expected[0], atol=1e-5)
        np.testing.assert_allclose(grid.features[row], expected[1:], atol=1e-5)


def test_a_weight_ends_at_its_limit():
    grid = SensorGrid(1)
    rows = torch.zeros(400, 1, dtype=torch.int64)
    for value in (1.0, 1.0, 0.0):
        grid.apply(grid.with_measurements(rows, torch.tensor([value]), torch.zeros(400, 4)))
    assert float(grid.weight[0]) == MAX_WEIGHT
    assert float(grid.tsdf[0]) == pytest.approx(500 / 900)  # the limit makes it forget: not 800 / 1200


def test_gradients_reach_the_features_of_the_present_frame():
    grid, features = SensorGrid(3), torch.ones(2, 4, requires_grad=True)
    update = grid.with_measurements(torch.tensor([[0], [0]]), torch.tensor([0.1]), features)
    update.features.sum().backward()
    assert torch.allclose(features.grad, torch.full((2, 4), 0.5))


def test_growing_keeps_what_is_there():
    grid = SensorGrid(2)
    grid.apply(grid.with_measurements(torch.tensor([[1]]), torch.tensor([0.1]), torch.ones(1, 4)))
    grid.grow(50)
    assert len(grid.tsdf) >= 50
    assert grid.weight[:3].tolist() == [0, 1, 0]


def test_where_one_sensor_reads_it_counts_alone():
    alpha = torch.tensor([0.3, 0.3, 0.3, 0.8])
    w1, w2 = torch.tensor([1.0, 1.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 1.0, 0.0])
    first, second = torch.full((4,), 1.0), torch.full((4,), 3.0)
    torch.testing.assert_close(fused_distance(alpha, first, second, w1, w2), torch.tensor([2.4, 1.0, 3.0, 1.0]))
    assert believed(alpha, w1, w2).tolist() == [True, False, True, True]


def test_the_networks_see_features_and_the_tanh_of_weights():
    features = (torch.ones(1, 2, 3, 4, 4), torch.full((1, 2, 3, 4, 4), 2.0))
    weights = (torch.full((1, 2, 3, 4), 0.5), torch.full((1, 2, 3, 4), 9.0))
    found = weighting_inputs(features, weights)
    assert found.shape == (1, 10, 2, 3, 4)
    expected = [1.0] * 4 + [np.tanh(0.5)] + [2.0] * 4 + [np.tanh(9.0)]
    np.testing.assert_allclose(found[0, :, 0, 0, 0], expected, rtol=1e-6)


@pytest.fixture
def model() -> SenfunetModel:
    return SenfunetModel.fresh(("sl", "sgm"), 0.02, torch.Generator().manual_seed(0))


def test_only_stereo_sees_colour(model):
    assert not model.features["sl"].color
    assert model.features["sgm"].color


@torch.no_grad()
def test_a_file_gives_the_networks_back_in_any_order(model, tmp_path):
    path = tmp_path / "pair.pt"
    model.save(path, {"frames": 1})
    loaded = SenfunetModel.load(("sgm", "sl"), path)
    assert loaded.sensors == ("sl", "sgm")  # the share is that of the sensor that was first in training
    depth = torch.rand(1, 1, 8, 8)
    torch.testing.assert_close(loaded.features["sl"](depth), model.features["sl"](depth), atol=5e-3, rtol=0)
    samples = torch.rand(1, 10, 6, 6, 6)
    torch.testing.assert_close(loaded.weighting(samples), model.weighting(samples), atol=5e-3, rtol=0)
    assert loaded.digest == SenfunetModel.load(("sl", "sgm"), path).digest


def test_a_simulated_sensor_uses_the_networks_of_its_kind(tmp_path):
    SenfunetModel.fresh(("sl", "dense"), 0.02, GENERATOR).save(tmp_path / "pair.pt", {})
    assert SenfunetModel.load(("sl", "psmnet"), tmp_path / "pair.pt").sensors == ("sl", "psmnet")


def test_wrong_files_are_named(model, tmp_path):
    path = tmp_path / "pair.pt"
    with pytest.raises(ConfigError, match="there is no"):
        SenfunetModel.load(("sl", "sgm"), path)
    path.write_bytes(b"nothing")
    with pytest.raises(ConfigError, match=r"pair\.pt: not a file of `uncle pretrain senfunet`"):
        SenfunetModel.load(("sl", "sgm"), path)
    torch.save({"format": "uncle senfunet", "version": 1, "sensors": ["sl"]}, path)
    with pytest.raises(ConfigError, match="damaged"):
        SenfunetModel.load(("sl", "sgm"), path)
    model.save(path, {})
    with pytest.raises(ConfigError, match="is of the sensors sl and sgm, not sl and tof"):
        SenfunetModel.load(("sl", "tof"), path)
    with pytest.raises(ConfigError, match="uncle pretrain senfunet DATASET --sensors radar tof"):
        SenfunetModel.load(("radar", "tof"))


def test_it_fuses_one_or_two_sensors():
    spec = method_spec("senfunet")
    spec.check_sensors(("sl",))
    spec.check_sensors(("sl", "sgm"))
    with pytest.raises(ConfigError, match=r"at most 2 sensors, not sl, sgm, tof.*--sensors sl sgm"):
        spec.check_sensors(("sl", "sgm", "tof"))


def test_the_package_brings_the_pairs_of_simulated_sensors():
    """Small files that load under the name of either kind, and give a share of 0 to 1."""
    assert shipped_pairs() == ["sgm+psmnet", "sl+psmnet", "sl+sgm"]
    assert sum(path.stat().st_size for path in SHIPPED.glob("*.pt")) < 300_000
    samples = torch.rand(1, 10, 8, 8, 8, generator=torch.Generator().manual_seed(0)) * 2
    for pair in (("sl", "psmnet"), ("dense", "sgm"), ("sgm", "sl")):
        model = SenfunetModel.load(pair)
        assert set(model.sensors) == set(pair)
        with torch.no_grad():
            share = model.weighting(samples)
        assert 0 <= float(share.min()) <= float(share.max()) <= 1
