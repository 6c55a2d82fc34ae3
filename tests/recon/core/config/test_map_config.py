"""Settings: what wins, what is refused and how it is said, and the TOML that records them."""

import tomllib

import pytest
from pydantic import BaseModel
from uncle.recon.core.config.map_config import MapConfig, known_keys, make_config, to_toml
from uncle.recon.core.config.presets import PRESETS
from uncle.recon.core.errors import ConfigError


def test_defaults_are_the_uncle_preset():
    assert make_config("uncle", []) == MapConfig()
    assert known_keys()["fusion.voxel_size_m"] == MapConfig().fusion.voxel_size_m


def test_baseline_neither_learns_nor_refines():
    config = make_config("tsdf", [])
    assert (config.method, config.fusion.passes, config.field.iterations) == ("tsdf", 0, 0)
    assert not config.uncertainty.enabled
    assert config.fusion.voxel_size_m == MapConfig().fusion.voxel_size_m


def test_override_wins_over_top_level_and_preset():
    config = make_config("tsdf", ["fusion.passes=2", "seed=7", "fusion.passes = 3"], seed=5, sensors=("a", "b"))
    assert (config.fusion.passes, config.seed, config.sensors) == (3, 7, ("a", "b"))
    assert not config.uncertainty.enabled  # the rest of the preset stays
    assert PRESETS["tsdf"]["fusion"] == {"passes": 0}  # and the preset itself


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("fusion.voxel_size=0.01", "did you mean fusion.voxel_size_m?"),
        ("feild.iterations=3", "did you mean field.iterations?"),
        ("qqqq=1", "groups: "),
        ("fusion.voxel_size_m", "expected key=value"),
        ("fusion=1", "no setting"),
        ("fusion.voxel_size_m=0.0005", "at least 0.001, or 0 for a size that is chosen"),
        ("fusion.voxel_size_m=-1", "fusion.voxel_size_m: Input should be greater than or equal to 0"),
        ("fusion.voxel_size_m=9", "less than or equal to 0.5"),
        ("fusion.voxel_size_m=big", "(got 'big')"),
        ("fusion.voxel_size_m=", "(got '')"),
        ("fusion.voxel_size_m=nan", "fusion.voxel_size_m"),
        ("fusion.max_depth_m=inf", "fusion.max_depth_m"),
        ("fusion.max_depth_m=1e9", "fusion.max_depth_m"),
        ("uncertainty.beta_min_m=inf", "uncertainty.beta_min_m"),
        ("fusion.passes=1.5", "valid integer"),
        ("field.levels=[0]", "field.levels"),
        ("field.levels=[-4]", "field.levels"),
        ("device=tpu", "'auto', 'cpu' or 'cuda'"),
        ("seed=-1", "seed"),
        ("seed=99999999999999999999", "seed"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(override, said):
    with pytest.raises(ConfigError) as caught:
        make_config("uncle", [override])
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_method_names_the_known():
    with pytest.raises(ConfigError, match=r"uncle, .*tsdf"):
        make_config("magic", [])


@pytest.mark.parametrize(
    ("method", "overrides"),
    [
        ("uncle", []), ("tsdf", []),
        ("uncle", ["uncertainty.beta_min_m=1e-5", "field.levels=[]", "seed=3", "fusion.max_depth_m=4"]),
    ],
)  # fmt: skip
def test_toml_reads_back_as_the_same_settings(method, overrides):
    config = make_config(method, overrides, sensors=("sl", "to-f"), hold_out=10)
    assert MapConfig.model_validate(tomllib.loads(to_toml(config))) == config


def test_every_known_key_can_be_set():
    for key, default in known_keys().items():
        assert not isinstance(default, BaseModel)
        value = (
            f'"{default}"'
            if isinstance(default, str)
            else str(list(default))
            if isinstance(default, tuple)
            else default
        )
        value = str(value).lower() if isinstance(default, bool) else value
        assert make_config("uncle", [f"{key}={value}"]) == MapConfig()


def test_the_method_is_no_setting_to_override():
    with pytest.raises(ConfigError, match="--method"):
        make_config("uncle", ["method=tsdf"])
