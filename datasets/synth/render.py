"""Ray-cast colour and depth images of a textured scene."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import open3d as o3d

from ...recon.core.camera import Camera
from .lighting import LightField
from .scene import Scene

_SUBPIXELS = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]], np.float32)  # rotated grid
_SHARPNESS = 0.7  # texels per pixel at which a smaller copy of a texture is taken
_ROW = 1024  # cv2.remap wants pictures, not lists
_INVALID = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True)
class View:
    """color (H, W, 3) float32 sRGB 0..255; depth (H, W) float32 metres along the optical axis, 0 = nothing there."""

    color: np.ndarray
    depth: np.ndarray


class Renderer:
    """Renders a scene through one camera. Thread-safe after construction."""

    def __init__(self, scene: Scene, camera: Camera, rng: np.random.Generator) -> None:
        self.scene = scene
        self.camera = camera
        self.raycaster = o3d.t.geometry.RaycastingScene()
        self.raycaster.add_triangles(o3d.core.Tensor(scene.vertices), o3d.core.Tensor(scene.faces.astype(np.uint32)))
        self.light_field = LightField(scene, self.raycaster, rng)
        corners = scene.vertices[scene.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._double_area = np.linalg.norm(cross, axis=1)
        self._normals = (cross / np.maximum(self._double_area, 1e-12)[:, None]).astype(np.float32)
        self._pyramids = [_pyramid(image) for image in scene.textures]
        self._texels_per_m = self._texel_density()
        v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
        self._pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        self._deepest = np.array([len(pyramid) - 1 for pyramid in self._pyramids])

    def _texel_density(self) -> np.ndarray:
        """(F,) how many texels of its full-size texture lie along a metre of each triangle."""
        edges = self.scene.uvs[:, 1:] - self.scene.uvs[:, :1]
        uv_area = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
        sizes = np.array([image.shape[0] * image.shape[1] for image in self.scene.textures])
        return np.sqrt(uv_area * sizes[self.scene.texture_ids] / np.maximum(self._double_area, 1e-12))

    def render(self, T_world_camera: np.ndarray) -> View:
        """The view from a pose (4, 4), OpenCV camera axes."""
        shape = (self.camera.height, self.camera.width)
        hits, color = self._trace(self._pixels, T_world_camera)
        depth = np.where(np.isfinite(hits.depth), hits.depth, 0).reshape(shape)
        edge = np.flatnonzero(self._edges(hits, shape).ravel())
        if edge.size:
            inner = (self._pixels[edge] + _SUBPIXELS[:, None]).reshape(-1, 2)
            samples = self._trace(inner, T_world_camera)[1].reshape(len(_SUBPIXELS), -1, 3)
            color[edge] = (color[edge] + samples.sum(axis=0)) / (len(_SUBPIXELS) + 1)
        return View(_to_srgb(color).reshape(*shape, 3), depth.astype(np.float32))

    def _trace(self, pixels: np.ndarray, T_world_camera: np.ndarray) -> tuple[_Hits, np.ndarray]:
        """Hits and (N, 3) linear colours of rays through pixels (N, 2)."""
        camera = self.camera
        directions = np.ones((len(pixels), 3), dtype=np.float32)
        directions[:, 0] = (pixels[:, 0] - camera.cx) / camera.fx
        directions[:, 1] = (pixels[:, 1] - camera.cy) / camera.fy
        directions = directions @ T_world_camera[:3, :3].T.astype(np.float32)
        origin = T_world_camera[:3, 3].astype(np.float32)
        rays = np.concatenate([np.broadcast_to(origin, directions.shape), directions], axis=1)
        answer = self.raycaster.cast_rays(o3d.core.Tensor(rays))
        # The third component of a direction in camera axes is 1, so the ray parameter is the depth.
        hits = _Hits(answer["t_hit"].numpy(), answer["primitive_ids"].numpy(), answer["primitive_uvs"].numpy())
        color = np.empty((len(pixels), 3), dtype=np.float32)
        lost = hits.faces == _INVALID
        color[lost] = _sky(directions[lost])
        seen = np.flatnonzero(~lost)
        points = origin + directions[seen] * hits.depth[seen, None]
        color[seen] = self._shade(hits, seen, points, directions[seen])
        return hits, color

    def _shade(self, hits: _Hits, seen: np.ndarray, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        faces = hits.faces[seen]
        normals = self._normals[faces]
        facing = np.einsum("nk,nk->n", normals, directions)
        normals = np.where(facing[:, None] > 0, -normals, normals)
        slant = np.abs(facing) / np.linalg.norm(directions, axis=1)
        footprint_m = hits.depth[seen] / self.camera.fx / np.sqrt(np.maximum(slant, 0.05))
        return self.albedo(faces, hits.barycentric[seen], footprint_m) * self.light_field.irradiance(points, normals)

    def albedo(self, faces: np.ndarray, barycentric: np.ndarray, footprint_m: np.ndarray) -> np.ndarray:
        """(N, 3) linear reflectance at barycentric (N, 2) of faces (N,), averaged over about `footprint_m` (N,)."""
        weights = np.concatenate([1 - barycentric.sum(axis=1, keepdims=True), barycentric], axis=1)
        uv = np.einsum("nc,ncx->nx", weights, self.scene.uvs[faces])
        level = np.log2(np.maximum(footprint_m * self._texels_per_m[faces] * _SHARPNESS, 1e-6))
        texture = self.scene.texture_ids[faces]
        level = np.clip(np.rint(level), 0, self._deepest[texture]).astype(np.int64)
        color = _to_linear(self._lookup(texture * 16 + level, uv))
        if self.scene.tints is not None:
            color *= np.einsum("nc,ncx->nx", weights, self.scene.tints[faces])
        return color

    def _lookup(self, keys: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """(N, 3) float32 texels 0..255; a key is texture * 16 + level."""
        order = np.argsort(keys, kind="stable")
        starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
        out = np.empty((len(keys), 3), dtype=np.float32)
        for start, end in zip(starts, [*starts[1:], len(keys)], strict=True):
            chosen = order[start:end]
            texture, level = divmod(int(keys[chosen[0]]), 16)
            out[chosen] = _sample(self._pyramids[texture][level], uv[chosen])
        return out

    def _edges(self, hits: _Hits, shape: tuple[int, int]) -> np.ndarray:
        """(H, W) pixels where one ray does not speak for the whole pixel."""
        seen = hits.faces != _INVALID
        faces = np.where(seen, hits.faces, 0)
        texture = np.where(seen, self.scene.texture_ids[faces], -1).reshape(shape)
        normal = np.where(seen[:, None], self._normals[faces], 0).reshape(*shape, 3)
        depth = np.where(seen, hits.depth, 0).reshape(shape)
        edge = np.zeros(shape, dtype=bool)
        for axis in (0, 1):
            here = (slice(None),) * axis + (slice(None, -1),)
            there = (slice(None),) * axis + (slice(1, None),)
            differs = texture[here] != texture[there]
            differs |= np.abs(np.einsum("ijk,ijk->ij", normal[here], normal[there])) < 0.95
            differs |= np.abs(depth[here] - depth[there]) > 0.1 * np.minimum(depth[here], depth[there])
            edge[here] |= differs
            edge[there] |= differs
        return edge


@dataclass(frozen=True)
class _Hits:
    depth: np.ndarray  # (N,) metres, inf = nothing
    faces: np.ndarray  # (N,) uint32
    barycentric: np.ndarray  # (N, 2) of corners 1 and 2


def _pyramid(image: np.ndarray) -> list[np.ndarray]:
    levels = [np.ascontiguousarray(image)]
    while min(levels[-1].shape[:2]) >= 4 and len(levels) < 16:
        height, width = levels[-1].shape[:2]
        levels.append(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return levels


def _sample(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear lookup with wrap-around: uv (N, 2), one image = 0..1 -> (N, 3)."""
    height, width = image.shape[:2]
    rows = -(-len(uv) // _ROW)
    grid = np.zeros((rows * _ROW, 2), dtype=np.float32)
    grid[: len(uv)] = (uv - np.floor(uv)) * [width, height] - 0.5
    pixels = grid.reshape(rows, _ROW, 2)
    texels: np.ndarray = cv2.remap(  # type: ignore[call-overload]  # its stub wants a second map
        image, pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    return texels.reshape(-1, 3)[: len(uv)]


def _to_linear(srgb: np.ndarray) -> np.ndarray:
    return np.square(srgb * np.float32(1 / 255))  # the square stands for the exact sRGB curve


def _to_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear light -> 0..255, the brightest parts rolled off rather than cut."""
    return (255 * np.sqrt(np.where(linear < 0.6, linear, 1 - 0.4 * np.exp(-(linear - 0.6) / 0.4)))).astype(np.float32)


def _sky(directions: np.ndarray) -> np.ndarray:
    """(N, 3) linear colour of what is seen where there is no surface: an overcast sky over haze."""
    rise = directions[:, 2] / np.linalg.norm(directions, axis=1)
    blend = np.clip(0.5 + 1.5 * rise, 0, 1)[:, None].astype(np.float32)
    return blend * np.array([0.62, 0.74, 0.9], np.float32) + (1 - blend) * np.array([0.7, 0.7, 0.66], np.float32)
