"""Weights survive the disk; NICE-SLAM checkpoints load; files that do not fit are named with the reason."""

import numpy as np
import pytest
import torch
from uncle.recon.core.errors import ConfigError
from uncle.recon.methods.nice.decoder_files import load_decoders, save_decoders
from uncle.recon.methods.nice.decoders import random_decoders


def nice_slam_model(decoders) -> dict[str, torch.Tensor]:
    """A state dict with the keys of NICE-SLAM's published `middle_fine.pt`, written out independently."""
    model = {"encoder.conv_in.weight": torch.zeros(3)}
    for name, decoder in (("coarse", decoders.middle), ("fine", decoders.fine)):
        state = decoder.state_dict()
        model[f"decoder.{name}.embedder._B"] = state["embedding"]
        for layer in range(5):
            for kind in ("weight", "bias"):
                model[f"decoder.{name}.pts_linears.{layer}.{kind}"] = state[f"hidden.{layer}.{kind}"]
                model[f"decoder.{name}.fc_c.{layer}.{kind}"] = state[f"injection.{layer}.{kind}"]
        model[f"decoder.{name}.output_linear.weight"] = state["output.weight"]
        model[f"decoder.{name}.output_linear.bias"] = state["output.bias"]
    return model


def same(first, second) -> bool:
    points, middle, fine = torch.rand(20, 3), torch.randn(20, 32), torch.randn(20, 32)
    return torch.equal(first.logits(points, middle, fine), second.logits(points, middle, fine))


def test_weights_and_recipe_survive(tmp_path):
    decoders = random_decoders(5)
    decoders.recipe["seed"] = 5
    save_decoders(tmp_path / "decoders.pt", decoders)
    loaded = load_decoders(tmp_path / "decoders.pt")
    assert same(decoders, loaded)
    assert loaded.recipe == {"seed": 5}
    assert loaded.origin == str(tmp_path / "decoders.pt")
    assert (tmp_path / "decoders.pt").stat().st_size < 400_000


def test_a_nice_slam_checkpoint_loads(tmp_path):
    """Beside the model such files hold an optimiser's state, counters and a NumPy score."""
    decoders = random_decoders(6)
    checkpoint = {"model": nice_slam_model(decoders), "optimizer": {"state": {}}, "it": 9, "best": np.float64(0.8)}
    torch.save(checkpoint, tmp_path / "middle_fine.pt")
    assert same(decoders, load_decoders(tmp_path / "middle_fine.pt"))


class Arbitrary:
    """Stands for code in a file."""


BROKEN = {
    "missing layer": (lambda model: model.pop("decoder.fine.fc_c.4.bias"), "fine decoder's injection.4.bias.*missing"),
    "other width": (
        lambda model: model.update({"decoder.coarse.pts_linears.1.weight": torch.zeros(64, 64)}), r"\(64, 64\)",
    ),
    "not a number": (
        lambda model: model["decoder.coarse.output_linear.bias"].fill_(float("nan")), "middle.*output.bias.*not finite",
    ),
    "no middle": (
        lambda model: [model.pop(key) for key in list(model) if "coarse" in key], "no middle decoder.*decoder.coarse",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", BROKEN)
def test_a_model_that_does_not_fit_is_explained(tmp_path, fault):
    damage, message = BROKEN[fault]
    model = {key: value.clone() for key, value in nice_slam_model(random_decoders(0)).items()}
    damage(model)
    torch.save({"model": model}, tmp_path / "file.pt")
    with pytest.raises(ConfigError, match=message):
        load_decoders(tmp_path / "file.pt")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"weights": 1}, "holds no decoders.*'weights'"), ([1, 2], "list, not a checkpoint"),
        ({"model": Arbitrary()}, "more than tensors"),
    ],
)  # fmt: skip
def test_other_files_of_pytorch_are_explained(tmp_path, content, message):
    torch.save(content, tmp_path / "file.pt")
    with pytest.raises(ConfigError, match=message):
        load_decoders(tmp_path / "file.pt")


def test_a_missing_and_a_damaged_file_are_explained(tmp_path):
    with pytest.raises(ConfigError, match="there is no file"):
        load_decoders(tmp_path / "none.pt")
    save_decoders(tmp_path / "cut.pt", random_decoders(0))
    (tmp_path / "cut.pt").write_bytes((tmp_path / "cut.pt").read_bytes()[:5000])
    with pytest.raises(ConfigError, match="damaged"):
        load_decoders(tmp_path / "cut.pt")
    (tmp_path / "text.pt").write_text("no tensors here")
    with pytest.raises(ConfigError, match="cannot read"):
        load_decoders(tmp_path / "text.pt")
