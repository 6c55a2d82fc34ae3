"""Which decoders serve mapping best: python benchmarks/decoders.py FILE [FILE ...] [--rooms 3] [--device cuda]

For every file of decoders (`random` stands for untrained ones) feature grids of made rooms never seen are optimised by
rendering depth, at the step sizes of mapping and with the decoders frozen. Scored are the first surfaces along rays of
other views, where the views of the fit have seen them: F at 5 and 2 cm, median and mean error of depth. Printed as JSON
are the medians over the rooms, and the scores that `uncle pretrain decoders` records.
"""

import argparse
import json
import statistics
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from uncle.recon.core.device import choose_device
from uncle.recon.methods.nice.decoder_files import load_decoders, shipped_decoders
from uncle.recon.methods.nice.decoders import CHANNELS, OCCUPANCY_SLOPE, OccupancyDecoders, random_decoders
from uncle.recon.methods.pretrain.decoder_scores import decoder_scores
from uncle.recon.methods.pretrain.grids import INITIAL_STD
from uncle.recon.methods.pretrain.rooms import Rooms, draw_rooms

CELL_M = {"middle": 0.32, "fine": 0.16}
BLOCKS = (240, 60, 60)  # iterations: a first frame, with 5 times the rates, and two later ones
SEEN_M = 0.08  # a place counts as seen if a view of the fit has a reading so near
SURFACE_STEP_M = 0.03


@dataclass(frozen=True)
class View:
    """Rays of all pixels of some views: origins and directions (R, 3), the latter of unit depth, and depths (R,)."""

    origin: Tensor
    direction: Tensor
    depth: Tensor

    def places(self) -> Tensor:
        return self.origin + self.direction * self.depth[:, None]

    def at(self, index: Tensor) -> "View":
        return View(self.origin[index], self.direction[index], self.depth[index])


def trace(room: Rooms, origin: Tensor, direction: Tensor, far: float = 12.0) -> Tensor:
    """Depth of the first surface along rays (R, 3), by steps of the distance itself; (R,)."""
    norm = torch.linalg.vector_norm(direction, dim=1)
    unit, along = direction / norm[:, None], torch.zeros_like(norm)
    for _ in range(80):
        distance = room.signed_distance((origin + unit * along[:, None])[None])[0]
        along = (along + 0.95 * distance.clamp(min=5e-4)).clamp(max=far)
    return along / norm


def draw_views(room: Rooms, views: int, side: int, generator: torch.Generator, device: torch.device) -> View:
    """Views of 90 degrees from free places at the height of hands and eyes, drawn on the CPU."""
    size = room.size[0]
    span = size * torch.tensor([1.0, 1.0, 0.4])
    places = (torch.rand(400, 3, generator=generator) - torch.tensor([0.5, 0.5, 0.0])) * span
    places = places + torch.tensor([0.0, 0.0, 0.9])
    places = places[room.signed_distance(places[None])[0] > 0.45][:views]
    pixel = (torch.arange(side) + 0.5) / side * 2 - 1
    v, u = torch.meshgrid(pixel, pixel, indexing="ij")
    rays = []
    for place in places:
        yaw, pitch = torch.rand(2, generator=generator) * torch.tensor([6.2832, 0.6]) - torch.tensor([0.0, 0.45])
        forward = torch.stack([yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin()])
        right = torch.nn.functional.normalize(torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0])), dim=0)
        down = torch.linalg.cross(forward, right)
        direction = forward + u[..., None] * right + v[..., None] * down
        rays.append((place.expand(side * side, 3), direction.reshape(-1, 3)))
    origin, direction = (torch.cat(parts).to(device) for parts in zip(*rays, strict=True))
    there = Rooms(**{name: value.to(device) for name, value in vars(room).items()})
    depth = [trace(there, o, d) for o, d in zip(origin.split(8192), direction.split(8192), strict=True)]
    return View(origin, direction, torch.cat(depth))


class RoomGrids:
    """Middle and fine grids over a room, moved to a random place of the world."""

    def __init__(
        self, decoders: OccupancyDecoders, size: Tensor, generator: torch.Generator, device: torch.device
    ) -> None:
        self.decoders = decoders
        margin = 0.3 + 0.3 * torch.rand(3, generator=generator)
        self.low = torch.tensor([-0.5, -0.5, 0.0]) * size - margin
        cells = ((size + 2 * margin) / CELL_M["middle"]).long() + 1
        self.high = self.low + cells * CELL_M["middle"]
        self.shift = (torch.rand(3, generator=generator) - 0.5) * 20
        self.values = {}
        for name, cell in CELL_M.items():
            shape = (cells * round(CELL_M["middle"] / cell) + 1).flip(0).tolist()
            values = torch.randn(1, CHANNELS, *shape, generator=generator) * INITIAL_STD[name]
            self.values[name] = values.to(device).requires_grad_()
        self.low, self.high, self.shift = (value.to(device) for value in (self.low, self.high, self.shift))

    def logits(self, points: Tensor, fine: bool) -> Tensor:
        """points: (..., 3) in the room's frame; (...). Outside of the grids all is solid."""
        flat = points.reshape(-1, 3)
        names = ("middle", "fine") if fine else ("middle",)
        place = ((flat - self.low) / (self.high - self.low) * 2 - 1)[None, :, None, None]
        grids = [self.values[name] for name in names]
        features = [torch.nn.functional.grid_sample(grid, place, align_corners=True)[0, :, :, 0, 0].T for grid in grids]
        outside = ((flat < self.low) | (flat > self.high)).any(dim=1)
        return torch.where(outside, 100.0, self.decoders.logits(flat + self.shift, *features)).reshape(
            points.shape[:-1]
        )

    def render(self, rays: View, far: float, fine: bool) -> Tensor:
        """Depth by volume rendering: 32 samples along each ray and 16 around its measured depth (NICE-SLAM)."""
        origin, direction, reading = rays.origin, rays.direction, rays.depth[:, None]
        inverse = 1 / torch.where(direction.abs() < 1e-6, 1e-6, direction)
        leaves = torch.maximum((self.low - origin) * inverse, (self.high - origin) * inverse).amin(dim=1, keepdim=True)
        near, end = 0.01 * reading, (leaves + 0.01).clamp(max=far)
        even, around = torch.linspace(0, 1, 32, device=near.device), torch.linspace(0.95, 1.05, 16, device=near.device)
        z = torch.cat([near + (end - near) * even, reading * around], dim=1)
        z = z.sort(dim=1).values
        logits = self.logits(origin[:, None] + direction[:, None] * z[..., None], fine)
        solid = torch.sigmoid(OCCUPANCY_SLOPE * logits)
        passed = torch.cumprod(torch.cat([torch.ones_like(z[:, :1]), 1 - solid + 1e-10], dim=1), dim=1)[:, :-1]
        return (solid * passed * z).sum(dim=1)

    def fit(self, view: View, rays: int, generator: torch.Generator) -> None:
        """Mapping as on a first frame and some later ones, on all views at once."""
        far = 1.2 * view.depth.max().item()
        for block, iterations in enumerate(BLOCKS):
            factor = 5.0 if block == 0 else 1.0
            optimizer = torch.optim.Adam([{"params": [values]} for values in self.values.values()])
            for iteration in range(iterations):
                fine = iteration > int(0.4 * iterations)
                optimizer.param_groups[0]["lr"] = factor * (0.005 if fine else 0.1)
                optimizer.param_groups[1]["lr"] = factor * (0.005 if fine else 0.0)
                index = torch.randint(len(view.depth), (rays,), generator=generator).to(view.depth.device)
                drawn = view.at(index)
                loss = (self.render(drawn, far, fine) - drawn.depth).abs().sum()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()

    @torch.no_grad()
    def first_surface(self, view: View) -> Tensor:
        """Depth of the first place along each ray where the logit changes its sign, (R,)."""
        along = torch.arange(SURFACE_STEP_M, 9.0, SURFACE_STEP_M, device=view.depth.device)
        found = []
        for origin, direction in zip(view.origin.split(400), view.direction.split(400), strict=True):
            logits = self.logits(origin[:, None] + direction[:, None] * along[:, None], fine=True)
            index = (logits > 0).float().argmax(dim=1).clamp(min=1)[:, None]
            before, after = logits.gather(1, index - 1)[:, 0], logits.gather(1, index)[:, 0]
            found.append(along[index[:, 0]] - SURFACE_STEP_M * (after / (after - before)).clamp(0, 1))
        return torch.cat(found)


def nearest(points: Tensor, others: Tensor) -> Tensor:
    return torch.cat([torch.cdist(part, others).amin(dim=1) for part in points.split(1000)])


def score_room(decoders: OccupancyDecoders, seed: int, side: int, rays: int, device: torch.device) -> dict[str, float]:
    """Fit and score one room of at most 4.6 m, drawn on the CPU so that every device sees the same."""
    generator = torch.Generator().manual_seed(10_000 + seed)
    room = draw_rooms(1, generator)
    while room.size[0, :2].max() > 4.6:
        room = draw_rooms(1, generator)
    fitted, other = (draw_views(room, views, pixels, generator, device) for views, pixels in ((14, side), (4, 28)))
    some = torch.arange(0, len(fitted.depth), max(1, side * side // 2304), device=device)
    other = other.at((nearest(other.places(), fitted.at(some).places()) < SEEN_M).nonzero()[:, 0])
    grids = RoomGrids(decoders.frozen(device), room.size[0], generator, device)
    began = time.monotonic()
    grids.fit(fitted, rays, generator)
    depth = grids.first_surface(other)
    ahead = depth - other.depth
    scores = {"seconds": time.monotonic() - began, "median_m": ahead.abs().median().item(),
              "mean_m": ahead.abs().mean().item(), "bias_m": ahead.median().item()}  # fmt: skip
    found, true = other.origin + other.direction * depth[:, None], other.places()
    precise, complete = room.signed_distance(found[None].cpu())[0].abs(), nearest(true, found)
    for bar in (0.05, 0.02):
        p, r = (precise < bar).float().mean().item(), (complete < bar).float().mean().item()
        scores |= {f"f_{100 * bar:.0f}cm": 2 * p * r / max(p + r, 1e-9), f"precision_{100 * bar:.0f}cm": p}
    return scores


def score(
    decoders: OccupancyDecoders, rooms: int, side: int, rays: int, device: torch.device, seed: int = 0
) -> dict[str, dict[str, float]]:
    """Medians over rooms, and the scores by places of known occupancy."""
    scores = [score_room(decoders, seed + room, side, rays, device) for room in range(rooms)]
    medians = {key: statistics.median(room[key] for room in scores) for key in scores[0]}
    return {"rooms": medians, "cubes": decoder_scores(decoders, device)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", help="files of decoders, `random` or `shipped`")
    parser.add_argument("--rooms", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--side", type=int, default=48, help="pixels along the side of each of the 14 views")
    parser.add_argument("--rays", type=int, default=400, help="in each iteration")
    parser.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    arguments = parser.parse_args()
    device = choose_device(arguments.device)
    named = {"random": lambda: random_decoders(0).frozen(), "shipped": shipped_decoders}
    for name in arguments.files:
        decoders = named[name]() if name in named else load_decoders(Path(name))
        scores = score(decoders, arguments.rooms, arguments.side, arguments.rays, device, arguments.seed)
        print(json.dumps({"decoders": name, **scores}, indent=2), flush=True)


if __name__ == "__main__":
    main()
