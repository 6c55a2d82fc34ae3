"""What h_w sees: shapes, and that no picture, however odd, gives a number it cannot use."""

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.sensors.noise_inputs import GREY, INVERSE_DEPTH, SENSOR_INPUTS, pixel_inputs, relative_spread

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)


def column(features: torch.Tensor, name: str) -> torch.Tensor:
    return features[..., SENSOR_INPUTS.index(name)]


def picture(depth: float | torch.Tensor = 2.0, grey: int = 128) -> dict[str, torch.Tensor]:
    depth = depth if isinstance(depth, torch.Tensor) else torch.full((48, 64), depth)
    normals = torch.zeros(48, 64, 3)
    normals[..., 2] = -1.0
    return {"depth": depth, "normals": normals, "color": torch.full((48, 64, 3), grey, dtype=torch.uint8)}


def painted(grey: np.ndarray) -> dict[str, torch.Tensor]:
    return picture() | {"color": torch.from_numpy(np.repeat(grey[..., None], 3, -1))}


def random_depth() -> torch.Tensor:
    depth = torch.rand(48, 64, generator=torch.Generator().manual_seed(0)) * 10
    return depth * (depth > 3)


@pytest.mark.parametrize(
    "inputs",
    [
        picture(), picture(depth=0.0), picture(grey=0), picture(grey=255), picture(depth=0.001), picture(depth=65.0),
        picture(depth=random_depth()), picture() | {"normals": torch.zeros(48, 64, 3)},
    ],
)  # fmt: skip
def test_always_finite_and_of_order_one(inputs):
    features = pixel_inputs(**inputs, camera=CAMERA)
    assert features.shape == (48, 64, len(SENSOR_INPUTS))
    assert features.dtype == torch.float32
    assert features.isfinite().all()
    assert features.abs().max() < 25
    assert features.half().isfinite().all()  # the ray store keeps them in half precision


def test_constants_have_no_spread_no_holes_and_no_texture():
    features = pixel_inputs(**picture(), camera=CAMERA)
    for window in (3, 7, 15):
        assert column(features, f"spread_{window}").max() < -1.3
        assert column(features, f"offset_{window}").abs().max() < 1e-4
        assert column(features, f"holes_{window}").abs().max() < 1e-5
    assert column(features, "texture_x_5").max() < -1.4
    assert column(features, "slope_x").abs().max() < 1e-4
    torch.testing.assert_close(column(features, "depth"), torch.full((48, 64), 2 / 3))
    assert float(column(features, "incidence")[24, 32]) == pytest.approx(1.0, abs=1e-3)


def test_local_features_see_only_their_window():
    depth = torch.full((48, 64), 2.0)
    depth[20, 30] = 2.2
    changed = pixel_inputs(**picture(depth), camera=CAMERA) - pixel_inputs(**picture(), camera=CAMERA)
    for window in (3, 7, 15):
        rows, columns = (column(changed, f"offset_{window}").abs() > 1e-4).nonzero().unbind(-1)
        assert int((rows - 20).abs().max()) == window // 2
        assert int((columns - 30).abs().max()) == window // 2


def test_holes_are_counted():
    depth = torch.full((48, 64), 2.0)
    depth[:, 32:] = 0
    holes = column(pixel_inputs(**picture(depth), camera=CAMERA), "holes_7")
    assert float(holes[24, 10]) == pytest.approx(0, abs=1e-5)
    assert float(holes[24, 50]) == pytest.approx(1, abs=1e-5)
    assert float(holes[24, 31]) == pytest.approx(3 / 7, abs=1e-5)


def test_slopes_and_texture_have_their_axes():
    ramp = np.arange(48, dtype=np.uint8) * 4
    sideways = pixel_inputs(**painted(np.tile(np.pad(ramp, (0, 16), "edge"), (48, 1))), camera=CAMERA)
    upwards = pixel_inputs(**painted(np.tile(ramp[:, None], (1, 64))), camera=CAMERA)
    assert column(sideways, "texture_x_5")[24, 24] > column(upwards, "texture_x_5")[24, 24] + 0.5
    across = torch.linspace(1.0, 3.0, 64).expand(48, 64).contiguous()
    features = pixel_inputs(**picture(across), camera=CAMERA)
    assert column(features, "slope_x")[24, 32] < -0.05
    assert float(column(features, "slope_y")[24, 32]) == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("window", [3, 7, 15])
def test_summary_of_a_neighbourhood_with_holes(window):
    depth = random_depth()
    features = pixel_inputs(**picture(depth), camera=CAMERA)
    reach = window // 2
    for row, line in ((24, 30), (20, 41)):
        around = depth[row - reach : row + reach + 1, line - reach : line + reach + 1].double()
        inverse = 1 / around[around > 0]
        own = 1 / float(depth[row, line]) if depth[row, line] > 0 else 0.0
        expected = {
            "spread": np.log10(float(inverse.std(unbiased=False)) + 1e-4) + 2.5,
            "offset": np.clip(20 * (own - float(inverse.mean())), -3, 3),
            "holes": float((around == 0).double().mean()),
        }
        for kind, value in expected.items():
            assert float(column(features, f"{kind}_{window}")[row, line]) == pytest.approx(value, abs=2e-3)


@pytest.mark.parametrize("encoding", [INVERSE_DEPTH, GREY])
def test_decoding_inverts_the_encoding(encoding):
    values = np.float32([0, 1e-4, 0.01, 0.3, 2.0])
    encoded = np.empty_like(values)
    encoding.encode(values, encoded)
    np.testing.assert_allclose(encoding.decode(torch.from_numpy(encoded)).numpy(), values, rtol=2e-3, atol=1e-8)


def test_relative_spread_is_that_of_the_depth_around():
    depth = torch.full((48, 64), 2.0)
    depth[:, 32:] = 3.0
    spread = relative_spread(pixel_inputs(**picture(depth), camera=CAMERA))
    inverse = np.array([1 / 2] * 4 + [1 / 3] * 3)  # in the window of the last column before the edge
    assert float(spread[24, 31]) == pytest.approx(inverse.std() * 2, rel=0.01)
    assert float(spread[24, 10]) == pytest.approx(0, abs=1e-3)
