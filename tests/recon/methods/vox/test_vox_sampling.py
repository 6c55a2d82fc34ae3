"""Samples at equal steps within voxels."""

import pytest
import torch
from uncle.recon.methods.vox.intersect import Hits
from uncle.recon.methods.vox.sampling import Samples, place_samples


@pytest.fixture
def hits() -> Hits:
    """Two voxels with a gap between; one voxel; none."""
    ids = torch.tensor([[4, 7, -1], [2, -1, -1], [-1, -1, -1]])
    entry = torch.tensor([[1.0, 1.5, 0.0], [0.3, 0.0, 0.0], [0.0, 0.0, 0.0]])
    exit = torch.tensor([[1.1, 1.525, 0.0], [0.35, 0.0, 0.0], [0.0, 0.0, 0.0]])
    return Hits(ids, entry, exit)


def test_steps_go_on_behind_a_gap(hits):
    samples = place_samples(hits, 0.02, torch.tensor([0.5, 0.25, 0.5]))
    assert samples.there.sum(1).tolist() == [6, 3, 0]
    first = torch.tensor([1.01, 1.03, 1.05, 1.07, 1.09, 1.51])
    torch.testing.assert_close(samples.z[0], first)
    torch.testing.assert_close(samples.z[1][:3], torch.tensor([0.305, 0.325, 0.345]))
    assert samples.voxels[0].tolist() == [4, 4, 4, 4, 4, 7]
    assert samples.voxels[1][:3].tolist() == [2, 2, 2]


def test_packed_and_padded_are_the_same_samples(hits):
    samples = place_samples(hits, 0.02, torch.zeros(3))
    ray, z, voxels = samples.packed()
    assert ray.tolist() == [0] * 7 + [1] * 3
    assert (voxels[ray == 1] == 2).all()
    padded = samples.pad(z)
    assert torch.equal(padded[samples.there], z)
    assert not padded[~samples.there].any()
    second = samples.of_rays(1, 3)
    assert torch.equal(second.packed()[1], z[ray == 1])


def test_no_sample_is_a_valid_batch(hits):
    none = Hits(hits.ids[2:], hits.entry[2:], hits.exit[2:])
    samples = place_samples(none, 0.02, torch.zeros(1))
    assert isinstance(samples, Samples)
    assert samples.z.shape == (1, 0)
    assert len(samples.index) == 0
