"""The map under construction: fusion, keyframe rays, and one noise model per sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ...core.frame import Frame
from ...mvs.bias_correction import BiasCorrection
from ...mvs.photometric_depth import PhotometricDepth
from ...mvs.sensor_reliability import DEFAULT_RELIABILITY, estimate_reliability, statements
from ...sensors.fault_detection import FaultDetector
from ...sensors.fusion_weights import FusionWeights
from ...sensors.intervals import fit_error_quantiles
from ...sensors.noise_inputs import noise_features
from ...sensors.noise_model import NoiseModel, Residuals
from ...volume.sparse_grid import SparseGrid
from ...volume.tsdf_surface import TsdfSurface
from ...volume.tsdf_volume import TsdfVolume
from .fusion_log import FusionLog
from .keyframes import KeyframeSelector
from .ray_batch import RayBatch
from .ray_buffer import RayBuffer, without_bias

_MAX_SELF_SHARE = 0.9  # readings that make up more of the map than this say nothing about themselves


class Mapper:
    """Adds posed frames to the map and learns from it how noisy each sensor is."""

    def __init__(self, camera: Camera, sensors: tuple[str, ...], config: MapConfig, device: torch.device) -> None:
        fusion = config.fusion
        self.camera, self.sensors, self.config, self.device = camera, sensors, config, device
        self.generator = torch.Generator().manual_seed(config.seed)
        grid = SparseGrid(fusion.voxel_size_m, device)
        truncation = fusion.truncation_voxels * fusion.voxel_size_m
        self.volume = TsdfVolume(grid, camera, truncation, fusion.max_depth_m)
        self.weights = FusionWeights(fusion, sensors)
        self.noise = {s: NoiseModel(config.uncertainty, self.generator).to(device) for s in sensors}
        self.bias = BiasCorrection(camera, sensors, config.uncertainty, config.seed, device)
        self.intervals: dict[str, dict[str, float]] = {}  # in betas, by sensor and per cent; of the finished map
        self.selector = KeyframeSelector(camera, config.keyframes)
        self.rays = RayBuffer(config.keyframes.max_rays)
        self.log = FusionLog()  # used while poses can still change
        self.said = dict.fromkeys(sensors, 0.0)  # weight of all readings of each sensor in the map
        self.witness = PhotometricDepth(
            camera, config.photometric, config.uncertainty, fusion.voxel_size_m, config.seed
        )
        self._surface: TsdfSurface | None = None  # until something is fused
        self.health = FaultDetector(camera, sensors, config.fault_detection, poses_given=not config.tracking.enabled)

    # --- one frame ---------------------------------------------------------------------------------------------
    def explore(self, frame: Frame, features: dict[str, Tensor], T_world_camera: Tensor) -> dict[str, Tensor]:
        """First look at a frame. Returns the beta images used, by sensor.

        A keyframe lends its rays; what the map predicts there, before the frame is part of it, teaches the noise
        models; then the frame is fused.
        """
        if self.selector.is_keyframe(frame, T_world_camera):
            rays = self._draw_rays(frame, features, T_world_camera)
            if self.config.uncertainty.enabled and self.volume.grid.rows:
                self._learn(rays, self.config.uncertainty.steps_per_keyframe, fused=False)
            self.rays.add(rays, self.generator)
        for depth in frame.depths.values():
            self.volume.allocate(depth.to(self.device), T_world_camera)
        return self.fuse(frame, features, T_world_camera)

    def fuse(self, frame: Frame, features: dict[str, Tensor], T_world_camera: Tensor) -> dict[str, Tensor]:
        """Fuse all sensors of a frame, readings weighted by their beta and what they are worth (`FusionWeights`).

        Returns beta (H, W) metres by sensor.
        """
        if self.config.tracking.enabled:
            self.log.note(frame.index, T_world_camera, self.noise, len(self.volume.grid.blocks))
        return self._integrate(frame, features, T_world_camera, self.noise)

    def refuse(self, frame: Frame, features: dict[str, Tensor], T_world_camera: Tensor) -> None:
        """Take a frame out of the map, exactly as it was put in, and fuse it again from where the camera is now known
        to be."""
        entry = self.log.entries[frame.index]
        self._integrate(frame, features, entry.T_world_camera, self.log.models(entry, self.noise), entry.blocks)
        self.volume.clear_empty()
        self.rays.move({frame.index: T_world_camera @ torch.linalg.inv(entry.T_world_camera)})
        for depth in frame.depths.values():
            self.volume.allocate(depth.to(self.device), T_world_camera)
        self.fuse(frame, features, T_world_camera)

    def _integrate(
        self,
        frame: Frame,
        features: dict[str, Tensor],
        T_world_camera: Tensor,
        noise: dict[str, NoiseModel],
        deintegrate_block_count: int | None = None,
    ) -> dict[str, Tensor]:
        color, self._surface = frame.color.to(self.device), None
        betas = {}
        for sensor, depth in frame.depths.items():
            depth, weight, free_space = depth.to(self.device), None, None
            if self.config.uncertainty.enabled:
                betas[sensor] = noise[sensor].beta_image(depth, features[sensor].to(self.device))
                weight, free_space = self.weights.for_sensor(betas[sensor], depth > 0, sensor)
            self.volume.integrate(depth, weight, color, T_world_camera, free_space, deintegrate_block_count)
            said = self._weight_near_surface(depth, weight)
            self.said[sensor] += said if deintegrate_block_count is None else -said
        return betas

    def _weight_near_surface(self, depth: Tensor, weight: Tensor | None) -> float:
        """What an image adds to the weights of the samples around its surface, up to a factor that all images share.

        A pixel covers an area that grows with the square of its depth (H, W) metres, and reaches as many samples.
        """
        area = torch.where(depth < self.config.fusion.max_depth_m, depth, 0.0).square()
        return float((area if weight is None else area * weight).sum(dtype=torch.float64))

    def weight_share(self) -> dict[str, float]:
        """Share of each sensor in the weights that decide where the surface of the map is; their sum is 1."""
        total = sum(self.said.values())
        return {sensor: said / total if total > 0 else 0.0 for sensor, said in self.said.items()}

    def clear_volume(self) -> None:
        """Empty the map for another sweep; keep its blocks and what was learned."""
        self.volume.reset()
        self._surface = None
        self.said = dict.fromkeys(self.sensors, 0.0)

    def pose(self, T_world_camera: Any) -> Tensor:
        """A (4, 4) matrix as the map takes it."""
        return torch.as_tensor(np.asarray(T_world_camera), dtype=torch.float32, device=self.device)

    def features(self, frame: Frame, normals: dict[str, Tensor]) -> dict[str, Tensor]:
        """(H, W, F) input of h_w for each sensor; nothing if the uncertainty is off."""
        if not self.config.uncertainty.enabled:
            return {}
        return {s: noise_features(d, normals[s], frame.color, self.camera) for s, d in frame.depths.items()}

    def judge(self, frame: Frame, T_world_camera: Tensor) -> Frame:
        """The frame, looked at by `health`, without the sensors that are at odds with the map as it is before it."""
        if not self.volume.grid.rows or not self.config.fault_detection.enabled:
            return frame
        if self._surface is None:
            self._surface = self.surface()
        predicted = self._surface.along(self.health.rays, T_world_camera)
        return self.health.compare(frame, predicted.cpu(), self.volume.max_depth_m)

    # --- the whole map -----------------------------------------------------------------------------------------
    def learn(self, raw_target: bool = False) -> dict[str, float]:
        """Fit the noise models to the residuals of all keyframe rays against the whole map; returns the mean nats.

        `raw_target`: residuals of the measurements as recorded, before bias correction, and the quantile objective;
        the error quantiles of each sensor are updated.
        """
        return self._learn(self.rays.columns, self.config.uncertainty.steps_per_pass, fused=True, raw_target=raw_target)

    def surface(self) -> TsdfSurface:
        """What the map shows now."""
        volume = self.volume
        return TsdfSurface(volume.grid, volume.sdf(), self.known(), volume.ray_far_m, volume.ray_step_m)

    def add_colors(self) -> None:
        """Fuse what colour says about the surface; each view stands for the frames between it and the next."""
        for depth, beta, T_world_camera in self.witness.readings():
            depth, beta, T_world_camera = (t.to(self.device) for t in (depth, beta, T_world_camera))
            weight, free_space = self.weights.of_color(beta, depth > 0, self.witness.frames_per_view)
            self.volume.allocate(depth, T_world_camera)
            self.volume.integrate(depth, weight, None, T_world_camera, free_space)

    def estimate_reliability(self) -> None:
        """Find what readings of each sensor are worth; only once no frame will be taken out of the map again."""
        self.weights.worth = self._worth()

    def _worth(self) -> dict[str, float]:
        """By sensor; 1 without validated photometric depth, `DEFAULT_RELIABILITY` if it is not to be estimated."""
        if not self.witness.confirmed:
            return dict.fromkeys(self.sensors, 1.0)
        if not self.config.photometric.estimate_reliability:
            return dict.fromkeys(self.sensors, DEFAULT_RELIABILITY)
        nominal = FusionWeights(self.config.fusion, self.sensors)
        said = statements(self.witness, self.noise, self.bias.models, nominal, self.volume.truncation_m)
        return estimate_reliability(said, self.witness.related(), self.volume.grid.voxel_size_m, self.sensors)

    def ray_batches(self) -> list[RayBatch]:
        """What the sensors read, without their biases, and what colour says.

        Betas are those of the finished map, of readings as they come: larger than what is left once a bias is off, and
        so is the say of colour about a sensor that had one.
        """
        said = []
        if len(self.rays):
            said.append(RayBatch.of_sensors(without_bias(self.rays, self.bias.models), self.noise, self.weights.worth))
        if self.witness.samples:
            said.append(RayBatch.of_color(self.witness, self.device))
        return said

    def known(self) -> Tensor:
        """(R,) samples that enough readings saw."""
        return self.volume.counts() >= self.config.fusion.min_observations

    def _learn(self, rays: dict[str, Tensor], steps: int, fused: bool, raw_target: bool = False) -> dict[str, float]:
        """`fused`: the map holds these rays already, which must be taken out of their own residuals."""
        hit = self.surface().cast(rays["origins"], rays["directions"])
        losses = {}
        for column, (sensor, model) in enumerate(self.noise.items()):
            depth, features = rays["depths"][:, column], rays["features"][:, column]
            used = (depth > 0) & (hit > 0)
            inputs, bias = features[used], self.bias.models[sensor]
            offset = torch.zeros_like(depth[used]) + bias.of(inputs.float())
            residual = depth[used] - offset - hit[used]
            if fused:
                points = rays["origins"][used] + rays["directions"][used] * hit[used, None]
                residual, trusted = self._without_itself(
                    residual, self.weights.of(model(inputs.float()), sensor), points
                )
                residual, inputs, offset = residual[trusted], inputs[trusted], offset[trusted]
            own = Residuals.against_truth(residual + offset if raw_target else residual, inputs)
            heard = own
            if fused and self.witness.samples:
                heard = own.joined(self.witness.against(column, None if raw_target else bias))
            losses[sensor] = model.learn(heard, steps, self.generator, quantile_objective=raw_target)
            if raw_target:
                self.intervals[sensor] = fit_error_quantiles(model.in_betas(own))
        return losses

    @torch.no_grad()
    def _without_itself(self, residual: Tensor, own: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals (N,) metres against the map without the reading itself, and which of them can be trusted.

        The map is a weighted mean, so leaving one reading of weight `own` (N,) out of a total W at `points` (N, 3)
        stretches its residual by 1 / (1 - own / W): a reading must not vouch for itself.
        """
        rows = self.volume.grid.nearest_rows(points)
        total = self.volume.sums[rows.clamp(min=0), 0]
        share = (own / total.clamp(min=1e-9)).clamp(max=1.0)
        near = residual.abs() < self.volume.truncation_m  # a reading further off had no say at this sample
        stretched = torch.where(near, residual / (1 - share.clamp(max=_MAX_SELF_SHARE)), residual)
        return stretched, ~near | (share < _MAX_SELF_SHARE)

    def _draw_rays(self, frame: Frame, features: dict[str, Tensor], T_world_camera: Tensor) -> dict[str, Tensor]:
        depths = torch.stack([depth.reshape(-1) for depth in frame.depths.values()], 1)
        usable = ((depths > 0) & (depths < self.config.fusion.max_depth_m)).any(1).nonzero()[:, 0]
        picks = (
            torch.randint(len(usable), (self.config.keyframes.rays,), generator=self.generator) if len(usable) else []
        )
        pixels = usable[picks]
        directions = self.camera.rays().view(-1, 3)[pixels] @ T_world_camera[:3, :3].cpu().T
        stacked = [image.view(-1, image.shape[-1])[pixels] for image in features.values()]
        rays = {
            "frames": torch.full((len(pixels),), frame.index),
            "origins": T_world_camera[:3, 3].cpu().repeat(len(pixels), 1),  # each its own: rays can move
            "directions": directions,
            "depths": depths[pixels],
            "colors": frame.color.view(-1, 3)[pixels],
            "features": torch.stack(stacked, 1).half() if stacked else torch.zeros(len(pixels), len(self.sensors), 0),
        }
        return {name: values.to(self.device) for name, values in rays.items()}

    # --- checkpoint --------------------------------------------------------------------------------------------
    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from, bit for bit."""
        return {
            "blocks": self.volume.grid.blocks,
            "sums": self.volume.sums,
            "color_sums": self.volume.color_sums,
            "noise": {sensor: model.training_state() for sensor, model in self.noise.items()},
            "keyframes": self.selector.T_camera_world,
            "rays": self.rays.columns,
            "log": self.log.state_dict(),
            "witness": self.witness.state_dict(),
            "said": self.said,
            "worth": self.weights.worth,
            "bias": self.bias.state_dict(),
            "intervals": self.intervals,
            "fault_detection": self.health.state_dict(),
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.volume.grid.restore(state["blocks"].to(self.device))
        self.volume.sums = state["sums"].to(self.device)
        self.volume.color_sums = state["color_sums"].to(self.device)
        for sensor, trained in state["noise"].items():
            self.noise[sensor].load_training_state(trained)
        self.selector.T_camera_world = list(state["keyframes"])
        self.rays.columns = {name: values.to(self.device) for name, values in state["rays"].items()}
        self.log.load_state_dict(state["log"], self.device)
        self.witness.load_state_dict(state["witness"])
        self.said = dict(state["said"])
        self.weights.worth = dict(state["worth"])
        self.bias.load_state_dict(state["bias"])
        self.intervals = dict(state["intervals"])
        self.health.load_state_dict(state["fault_detection"])
        self.generator.set_state(state["generator"].cpu())
