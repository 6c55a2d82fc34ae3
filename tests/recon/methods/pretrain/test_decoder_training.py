"""The training of the decoders: it repeats, it learns, world positions say nothing, features near zero are free."""

import pytest
import torch
from uncle.recon.methods.nice.decoder_files import shipped_decoders
from uncle.recon.methods.nice.decoders import random_decoders
from uncle.recon.methods.pretrain.cubes import CubeBatch, cube_losses
from uncle.recon.methods.pretrain.decoder_scores import decoder_scores
from uncle.recon.methods.pretrain.decoder_training import DecoderTrainer, DecoderTraining

CPU = torch.device("cpu")
TINY = DecoderTraining(steps=30, cubes=12, points=128, pool=512, life=24, free_points=256)


@pytest.fixture(scope="module")
def trained():
    trainer = DecoderTrainer(TINY, CPU)
    losses = torch.stack([trainer.step() for _ in range(TINY.steps)])
    return trainer, losses


def test_losses_fall(trained):
    _, losses = trained
    assert (losses[-5:].mean(dim=0) < 0.9 * losses[:3].mean(dim=0)).all()


def test_a_seed_fixes_the_training(trained):
    _, losses = trained
    again = DecoderTrainer(TINY, CPU)
    torch.testing.assert_close(torch.stack([again.step() for _ in range(3)]), losses[:3])


def test_a_restored_training_has_the_same_decoders_and_step(trained):
    trainer, _ = trained
    other = DecoderTrainer(TINY, CPU)
    other.restore(trainer.state())
    assert other.done == TINY.steps
    assert torch.equal(other.decoders.fine.output.weight, trainer.decoders.fine.output.weight)


def test_cubes_grow_older_one_group_after_the_other():
    trainer = DecoderTrainer(DecoderTraining(steps=60, cubes=12, points=16, pool=64, life=24, free_points=16), CPU)
    for _ in range(50):
        trainer.step()
    ages = trainer.cubes.grids.age.tolist()
    assert len(set(ages)) == 12
    assert max(ages) <= 24


def test_features_move_at_the_rates_of_their_stage():
    """The first steps of Adam have the length of the rate: the middle grid alone, then both at the fine rate."""
    batch = CubeBatch(2, 16, 10, torch.Generator().manual_seed(0))
    batch.factor[:] = torch.tensor([1.0, 5.0])
    moved = []
    for _ in range(2):
        before = {name: grid.clone() for name, grid in batch.grids.values.items()}
        batch.move({name: torch.ones_like(grid) for name, grid in batch.grids.values.items()})
        moved.append({name: (before[name] - grid).mean(dim=(1, 2, 3, 4)) for name, grid in batch.grids.values.items()})
        batch.grids.age[:] = 4
    torch.testing.assert_close(moved[0]["middle"], torch.tensor([0.1, 0.5]), rtol=1e-3, atol=0)
    assert moved[0]["fine"].abs().max() == 0
    assert moved[1]["middle"].max() < 0.05
    assert moved[1]["fine"].min() > 0.001


def test_cross_entropy_with_the_slope_of_rendering():
    logits = (torch.tensor([[0.1, -0.2]]), torch.tensor([[0.0, 0.3]]))
    solid = torch.tensor([[1.0, 0.0]])
    p = (
        torch.sigmoid(torch.tensor([1.0, -2.0, 0.0, 3.0])).log(),
        torch.sigmoid(-torch.tensor([1.0, -2.0, 0.0, 3.0])).log(),
    )
    expected = torch.stack([-(p[0][0] + p[1][1]), -(p[0][2] + p[1][3])])
    torch.testing.assert_close(cube_losses(logits, solid), expected)


def test_shipped_decoders_call_features_near_zero_mildly_free():
    decoders, generator = shipped_decoders(), torch.Generator().manual_seed(1)
    points = (torch.rand(5000, 3, generator=generator) - 0.5) * 30
    middle, fine = (torch.randn(5000, 32, generator=generator) * std for std in (1e-2, 1e-4))
    for logits in (decoders.logits(points, middle), decoders.logits(points, middle, fine)):
        assert logits.mean() > -2
        assert logits.max() < 0
        assert torch.sigmoid(10 * logits).max() < 0.5


def test_shipped_decoders_do_not_ask_where_in_the_world_a_place_is():
    """The same features mean nearly the same anywhere: signs agree, but at surfaces."""
    decoders, generator = shipped_decoders(), torch.Generator().manual_seed(2)
    middle, fine = (torch.randn(3000, 32, generator=generator) * std for std in (0.5, 0.1))
    near, far = (torch.rand(3000, 3, generator=generator) * 4 + shift for shift in (0.0, 500.0))
    first, second = decoders.logits(near, middle, fine), decoders.logits(far, middle, fine)
    assert ((first > 0) == (second > 0)).float().mean() > 0.95


def test_shipped_decoders_describe_rooms_that_they_never_saw():
    scores = decoder_scores(shipped_decoders(), CPU, cubes=3, steps=60, pool=4096)
    untrained = decoder_scores(random_decoders(0), CPU, cubes=3, steps=60, pool=4096)
    assert scores["fine_iou"] > 0.85
    assert scores["fine_iou"] > scores["middle_iou"]
    assert scores["fine_iou"] > untrained["fine_iou"] + 0.02
    assert scores["fresh_logit"] < 0
    assert scores["fresh_occupancy"] < 0.5
