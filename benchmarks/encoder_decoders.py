"""Decoders trained with an encoder instead of optimised grids, for comparison in benchmarks/decoder_recipes.py.

A small 3D convolutional network turns noisy surface points into both grids (as convolutional occupancy networks do);
everything else is as in `uncle pretrain decoders`. See docs/pretraining.md for the figures.
"""

import torch
from torch import Tensor, nn
from uncle.recon.methods.nice.decoders import OccupancyDecoders
from uncle.recon.methods.pretrain.crops import Crops, draw_crops, sample_crops
from uncle.recon.methods.pretrain.cubes import cube_logits, cube_losses
from uncle.recon.methods.pretrain.decoder_training import DecoderTrainer, DecoderTraining, _schedule
from uncle.recon.methods.pretrain.grids import EXTENT_M, interpolate

SIDE = 16  # cells of 8 cm into which the points are sorted
NOISE_M = 0.005
SURFACE_POINTS = 2048


class Encoder(nn.Module):
    """From points on surfaces (S, P, 3) to features at the vertices of the middle (5^3) and fine (9^3) grids."""

    def __init__(self) -> None:
        super().__init__()
        self.cells = nn.Sequential(
            nn.Conv3d(4, 32, 3, padding=1), nn.ReLU(), nn.Conv3d(32, 32, 4, stride=2, padding=2), nn.ReLU()
        )  # fmt: skip
        self.down = nn.Sequential(
            nn.Conv3d(32, 64, 3, stride=2, padding=1), nn.ReLU(), nn.Conv3d(64, 64, 3, padding=1), nn.ReLU()
        )
        self.middle = nn.Conv3d(64, 32, 3, padding=1)
        self.fine = nn.Sequential(nn.Conv3d(96, 64, 3, padding=1), nn.ReLU(), nn.Conv3d(64, 32, 3, padding=1))

    def forward(self, points: Tensor) -> dict[str, Tensor]:
        cells = self.cells(sort_points(points))
        low = self.down(cells)
        up = nn.functional.interpolate(low, size=cells.shape[2:], mode="trilinear", align_corners=True)
        return {"middle": self.middle(low), "fine": self.fine(torch.cat([cells, up], dim=1))}


def sort_points(points: Tensor) -> Tensor:
    """Log count and mean offset from the centre, in cells, of the points in every cell: (S, 4, z, y, x)."""
    place = (points / EXTENT_M + 0.5) * SIDE
    cell = place.long().clamp(0, SIDE - 1)
    index = (cell[..., 2] * SIDE + cell[..., 1]) * SIDE + cell[..., 0]
    sums = points.new_zeros(len(points), SIDE**3, 4)
    values = torch.cat([torch.ones_like(place[..., :1]), place - cell - 0.5], dim=-1)
    sums.scatter_add_(1, index[..., None].expand(-1, -1, 4), values)
    count = sums[..., :1]
    filled = torch.cat([torch.log1p(count), sums[..., 1:] / count.clamp(min=1)], dim=-1)
    return filled.transpose(1, 2).reshape(-1, 4, SIDE, SIDE, SIDE)


def surface_points(crops: Crops, generator: torch.Generator) -> Tensor:
    """Noisy points on the surfaces of the cubes: near places moved along the gradient of the distance."""
    places, _ = sample_crops(crops, 2 * SURFACE_POINTS, EXTENT_M, generator)
    places = places[:, SURFACE_POINTS:].requires_grad_()
    distance = crops.signed_distance(places)
    (slope,) = torch.autograd.grad(distance.sum(), places)
    align_to_tsdf = places.detach() - distance.detach()[..., None] * slope
    return align_to_tsdf + NOISE_M * torch.randn(align_to_tsdf.shape, generator=generator, device=places.device)


def train_with_encoder(settings: DecoderTraining, device: torch.device) -> OccupancyDecoders:
    """The trainer lends its decoders, and its cubes their places; their grids are not used."""
    trainer = DecoderTrainer(settings, device)
    torch.manual_seed(settings.seed)
    encoder = Encoder().to(device)
    optimizer = torch.optim.Adam([*trainer.parameters, *encoder.parameters()], lr=settings.learning_rate)
    generator, size = trainer.cubes.generator, settings.cubes // settings.groups
    seen = torch.zeros(settings.cubes, SURFACE_POINTS, 3, device=device)
    for step in range(settings.steps):
        if step % (settings.life // settings.groups) == 0:
            parts = range(settings.groups) if step == 0 else [step * settings.groups // settings.life % settings.groups]
            for group in parts:
                part = slice(group * size, (group + 1) * size)
                crops = draw_crops(size, generator)
                places, distance = sample_crops(crops, settings.pool, EXTENT_M, generator)
                trainer.cubes.places[part], trainer.cubes.solid[part] = places, (distance < 0).float()
                seen[part] = surface_points(crops, generator)
        points, solid = trainer.cubes.draw(settings.points)
        grids = encoder(seen)
        logits = cube_logits(trainer.decoders, points, {n: interpolate(g, points) for n, g in grids.items()}, generator)
        loss = (
            cube_losses(logits, solid, settings.slope).sum() / solid.numel()
            + settings.free_weight * trainer.free_loss()
        )
        optimizer.param_groups[0]["lr"] = settings.learning_rate * _schedule(step, settings.steps)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return trainer.decoders
