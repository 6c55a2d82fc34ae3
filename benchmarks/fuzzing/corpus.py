"""Small valid inputs of every kind, all made by code from one box-shaped room."""

from __future__ import annotations

import base64
import io
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import tifffile
from scipy.spatial.transform import Rotation
from uncle.recon.core.camera import Camera
from uncle.recon.core.mesh import Mesh

from .samples import Sample

FRAMES = 4
CAMERA = Camera(64, 48, 50.0, 52.0, 31.0, 24.0)
LOW, HIGH = np.array([-1.0, -1.3, -0.9]), np.array([1.6, 1.2, 1.5])
CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * (HIGH - LOW) + LOW
QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
TRIANGLES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]]).astype(np.int32)
Files = dict[str, bytes]


@dataclass(frozen=True)
class View:
    """color (H, W, 3) uint8 RGB, depth (H, W) float32 metres, pose (4, 4) T_world_camera, time in seconds."""

    color: np.ndarray
    depth: np.ndarray
    pose: np.ndarray
    time: float


@cache
def views() -> tuple[View, ...]:
    """A camera that turns in the room."""
    made = []
    for index in range(FRAMES):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler(
            "xyz", [20 + 4 * index, 9 * index + 3, 3 * index + 1], degrees=True
        ).as_matrix()
        pose[:3, 3] = [0.05 * index, -0.03 * index, 0.15]
        directions = CAMERA.rays().numpy().astype(np.float64) @ pose[:3, :3].T
        depth = np.maximum((LOW - pose[:3, 3]) / directions, (HIGH - pose[:3, 3]) / directions).min(axis=-1)
        points = pose[:3, 3] + directions * depth[..., None]
        color = 128 + 60 * np.sin(9 * points) + 40 * np.sin(31 * points[..., ::-1])
        made.append(View(np.clip(color, 0, 255).astype(np.uint8), depth.astype(np.float32), pose, 10 + 0.1 * index))
    return tuple(made)


# --- parts of files --------------------------------------------------------------------------------------------------
def encoded(suffix: str, image: np.ndarray) -> bytes:
    """An image as OpenCV writes it; colour is RGB."""
    return cv2.imencode(suffix, image[..., ::-1] if image.ndim == 3 else image)[1].tobytes()


def depth_png(view: View, units_per_m: float = 1000.0) -> bytes:
    """16 bits."""
    return encoded(".png", np.round(view.depth * units_per_m).astype(np.uint16))


def _saved(write: Callable[[Path], object], suffix: str) -> bytes:
    """What a function writes to the path that it is given."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{suffix}"
        write(path)
        return path.read_bytes()


def _npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def _npz(**arrays: object) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def exr(depth: np.ndarray) -> bytes:
    """One channel, Z."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    return _saved(lambda path: OpenEXR.File(header, {"Z": depth}).write(str(path)), ".exr")


def rows(*columns: np.ndarray | float | list[float]) -> str:
    """Numbers of a line."""
    return " ".join(f"{value:.9g}" for column in columns for value in np.ravel(column))


def vector(pose: np.ndarray) -> np.ndarray:
    """tx ty tz qx qy qz qw"""
    return np.concatenate([pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat()])


def lines(*texts: str) -> bytes:
    """A text file."""
    return "\n".join([*texts, ""]).encode()


def matrix_text(matrix: np.ndarray) -> bytes:
    """A line for each row."""
    return lines(*(rows(row) for row in matrix))


def camera_json(**fields: object) -> bytes:
    """`camera.json` of the room."""
    return json.dumps({"width": 64, "height": 48, "fx": 50.0, "fy": 52.0, "cx": 31.0, "cy": 24.0, **fields}).encode()


INTRINSICS = lines("50 0 31", "0 52 24", "0 0 1")


# --- files of one kind -----------------------------------------------------------------------------------------------
def _single(files: Files) -> list[Sample]:
    return [Sample(name, {name: content}, name) for name, content in files.items()]


def trajectories() -> list[Sample]:
    """Every format of `recon/core/pose_tables.py`."""
    poses, times = [view.pose for view in views()], [view.time for view in views()]
    vectors = [vector(pose) for pose in poses]
    euroc = [",".join([f"{t * 1e9:.0f}", *(f"{v:.9f}" for v in [*row[:3], row[6], *row[3:6]])])
             for t, row in zip(times, vectors, strict=True)]  # fmt: skip
    columns = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    graph = [f"VERTEX_SE3:QUAT {i} {rows(row)}" for i, row in enumerate(vectors)]
    toro = [f"VERTEX3 {i} {rows(pose[:3, 3])} 0.1 0.2 0.3" for i, pose in enumerate(poses)]
    information = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
    log = [f"{i} {i} {i + 1}\n" + "\n".join(rows(row) for row in pose) for i, pose in enumerate(poses)]
    pairs = list(zip(times, vectors, strict=True))
    numbered = [f"{t} {rows(row)} {i}" for i, (t, row) in enumerate(pairs)]
    return _single({
        "tum.txt": lines("# timestamp tx ty tz qx qy qz qw", *(f"{t:.4f} {rows(row)}" for t, row in pairs)),
        "euroc.csv": lines(columns, *euroc),
        "kitti.txt": lines(*(rows(pose[:3]) for pose in poses)),
        "kitti360.txt": lines(*(f"{i} {rows(pose)}" for i, pose in enumerate(poses))),
        "rtabmap.txt": lines("#timestamp x y z qx qy qz qw id", *numbered),
        "trajectory.log": lines(*log),
        "matrices.txt": lines(*(rows(row) for pose in poses for row in pose)),
        "graph.g2o": lines(*graph, f"EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 {information}"),
        "toro.graph": lines(*toro),
        "vectors.txt": lines(*(rows(row) for row in vectors)),
        "named.txt": lines(*(f"color/{i:04d}.png {rows(row)}" for i, row in enumerate(vectors))),
    })  # fmt: skip


def single_poses() -> list[Sample]:
    """Files of one pose each."""
    pose = views()[1].pose
    return _single({
        "matrix.txt": matrix_text(pose), "3x4.txt": matrix_text(pose[:3]), "line.txt": lines(rows(pose)),
        "vector.txt": lines(rows(vector(pose))), "column.txt": lines(*(rows([v]) for v in vector(pose))),
    })  # fmt: skip


def cameras() -> list[Sample]:
    """Every file that states a camera; the given path is the folder."""
    identity = rows(np.eye(4))
    kinect = rows([50, 0, 31, 0, 0, 52, 24, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    info = [f"m_{kind}{side} = {size}" for kind in ("color", "depth") for side, size in (("Width", 64), ("Height", 48))]
    info += [f"m_calibration{kind}Intrinsic = {kinect}" for kind in ("Color", "Depth")]
    info += ["m_calibrationDepthExtrinsic = " + identity, "m_depthShift = 1000"]
    color = {"width": 64, "height": 48, "fx": 50.0, "fy": 52.0, "cx": 31.0, "cy": 24.0}
    moved = np.eye(4)
    moved[0, 3] = 0.025
    open3d = {"width": 64, "height": 48, "intrinsic_matrix": [50, 0, 0, 0, 52, 0, 31, 24, 1]}
    files = {
        "camera.json": camera_json(depth_scale=1000.0),
        "distorted/camera.json": camera_json(distortion=[0.1, -0.05, 0.001, 0.0, 0.01]),
        "fisheye/camera.json": camera_json(distortion=[0.05, -0.02, 0.01, 0.0], distortion_model="fisheye"),
        "two/camera.json": camera_json(color_camera=color, T_color_depth=moved.tolist()),
        "camera-intrinsics.txt": INTRINSICS,
        "calibration.txt": lines("50 52 31 24"),
        "distortion/calibration.txt": lines("50 52 31 24 0.1 -0.05 0.001 0"),
        "info.txt": lines(*info),
        "camera_intrinsic.json": json.dumps(open3d).encode(),
    }
    return [Sample(name, {name.rpartition("/")[2]: content}) for name, content in files.items()]


def depth_images() -> list[Sample]:
    """Every format of `recon/core/depth_image.py`."""
    depth = views()[0].depth
    units = np.round(depth * 1000).astype(np.uint16)
    pgm = b"P5\n# a comment\n64 48\n65535\n" + units.astype(">u2").tobytes()
    plain = b"P2\n64 48\n65535\n" + " ".join(map(str, units.ravel())).encode() + b"\n"
    return _single({
        "depth.png": encoded(".png", units),
        "float.tif": encoded(".tif", depth),
        "units.tiff": encoded(".tiff", units),
        "half.tif": _saved(lambda path: tifffile.imwrite(path, depth.astype(np.float16)), ".tif"),
        "deflated.tif": _saved(lambda path: tifffile.imwrite(path, depth, compression="zlib"), ".tif"),
        "pages.tif": _saved(lambda path: tifffile.imwrite(path, np.stack([units] * 2)), ".tif"),
        "depth.exr": exr(depth),
        "depth.npy": _npy(depth),
        "units.npy": _npy(units),
        "depth.npz": _npz(depth=depth),
        "several.npz": _npz(depth=units, color=views()[0].color),
        "depth.pfm": encoded(".pfm", depth),
        "depth.pgm": pgm,
        "plain.pgm": plain,
    })  # fmt: skip


def color_images() -> list[Sample]:
    """PNG of several kinds, and JPG."""
    color = views()[0].color
    return _single({
        "color.png": encoded(".png", color), "color.jpg": encoded(".jpg", color),
        "gray.png": encoded(".png", color[..., 0]), "deep.png": encoded(".png", color.astype(np.uint16) * 257),
        "alpha.png": encoded(".png", np.dstack([color, color[..., :1]])),
    })  # fmt: skip


def _ply_text() -> bytes:
    kinds = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue", "float sigma"]
    head = ["ply", "format ascii 1.0", "comment made", "element vertex 8", *(f"property {kind}" for kind in kinds)]
    head += ["element face 6", "property list uchar int vertex_indices", "end_header"]
    vertices = [f"{rows(corner)} {10 * i} 20 30 0.01" for i, corner in enumerate(CORNERS)]
    return lines(*head, *vertices, *(f"4 {rows(quad)}" for quad in QUADS))


def _pcd(form: str, body: bytes) -> bytes:
    head = ["VERSION 0.7", "FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", "COUNT 1 1 1", "WIDTH 8", "HEIGHT 1"]
    return lines(*head, "VIEWPOINT 0 0 0 1 0 0 0", "POINTS 8", f"DATA {form}") + body


def _gltf() -> bytes:
    """With a transformed node, and the buffer inside."""
    buffer = CORNERS.astype("<f4").tobytes() + TRIANGLES.astype("<u2").tobytes()
    return json.dumps({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "rotation": [0, 0, 0.6, 0.8]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 4}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": TRIANGLES.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": 2 * TRIANGLES.size},
        ],
        "buffers": [{"byteLength": len(buffer), "uri": "data:;base64," + base64.b64encode(buffer).decode()}],
    }).encode()  # fmt: skip


def meshes() -> list[Sample]:
    """Every format of `recon/core/mesh_files`, meshes and point clouds."""
    colors = np.arange(24, dtype=np.uint8).reshape(8, 3) * 10
    mesh = Mesh(CORNERS.astype(np.float32), TRIANGLES, colors, np.full(8, 0.01, np.float32))
    obj = ["# made", "mtllib none.mtl", *(f"v {rows(corner)}" for corner in CORNERS), "vt 0 0", "vn 0 0 1"]
    obj += [f"f {' '.join(f'{v + 1}/1/1' for v in quad)}" for quad in QUADS[:4]]
    obj += [f"f {' '.join(str(v - 8) for v in quad)}" for quad in QUADS[4:]]
    facets = [f"facet normal 0 0 1\nouter loop\n{corners}\nendloop\nendfacet" for corners in
              ("\n".join(f"vertex {rows(CORNERS[v])}" for v in face) for face in TRIANGLES)]  # fmt: skip
    cloud = [rows(corner) for corner in CORNERS]
    samples = _single({
        **{f"mesh{suffix}": _saved(mesh.save, suffix) for suffix in (".ply", ".obj", ".stl", ".off", ".glb")},
        "text.ply": _ply_text(),
        "quads.obj": lines(*obj),
        "text.stl": lines("solid made", *facets, "endsolid made"),
        "quads.off": lines("OFF", "8 6 0", *cloud, *(f"4 {rows(quad)}" for quad in QUADS)),
        "scene.gltf": _gltf(),
        "text.pcd": _pcd("ascii", lines(*cloud)),
        "binary.pcd": _pcd("binary", CORNERS.astype("<f4").tobytes()),
        "cloud.xyz": lines(*cloud),
        "cloud.pts": lines("8", *(f"{point} 1 2 3" for point in cloud)),
    })  # fmt: skip
    buffers = json.loads(_gltf())
    data = base64.b64decode(buffers["buffers"][0]["uri"].partition(",")[2])
    buffers["buffers"][0]["uri"] = "scene.bin"
    return [*samples, Sample("beside", {"beside.gltf": json.dumps(buffers).encode(), "scene.bin": data}, "beside.gltf")]


# --- data sets -------------------------------------------------------------------------------------------------------
def datasets() -> list[Sample]:
    """A recording in the layout of every reader of `datasets/registry.py`."""
    return [_own(), _own_floats(), _open3d(), _senfunet(), _replica(), _seven_scenes(), _tum(), _scannet()]


def _own() -> Sample:
    files = {"camera.json": camera_json(depth_scale=1000.0), "mesh_gt.ply": _ply_text()}
    for i, view in enumerate(views()):
        files[f"color/{i:04d}.png"] = encoded(".png", view.color)
        files[f"depth_sl/{i:04d}.png"] = files[f"depth_tof/{i:04d}.png"] = depth_png(view)
    files["poses.txt"] = lines(*(f"{i} {rows(vector(view.pose))}" for i, view in enumerate(views())))
    files["timestamps.txt"] = lines(*(f"{i:04d}.png {view.time}" for i, view in enumerate(views())))
    return Sample("folder", files)


def _own_floats() -> Sample:
    """Float depth of several formats, a pose file for each image, a bent lens."""
    files = {"camera.json": camera_json(distortion=[0.1, -0.05, 0.001, 0.0])}
    for i, view in enumerate(views()):
        files[f"color/{i:04d}.jpg"] = encoded(".jpg", view.color)
        files[f"depth/{i:04d}.npy"] = _npy(view.depth)
        files[f"depth_tif/{i:04d}.tif"] = encoded(".tif", view.depth)
        files[f"depth_exr/{i:04d}.exr"] = exr(view.depth)
        files[f"poses/{i:04d}.txt"] = matrix_text(view.pose)
    return Sample("folder-floats", files)


def _open3d() -> Sample:
    open3d = {"width": 64, "height": 48, "intrinsic_matrix": [50, 0, 0, 0, 52, 0, 31, 24, 1]}
    files = {"camera_intrinsic.json": json.dumps(open3d).encode()}
    for i, view in enumerate(views()):
        files[f"color/{i:05d}.jpg"], files[f"depth/{i:05d}.png"] = encoded(".jpg", view.color), depth_png(view)
    log = [f"{i} {i} {i + 1}\n" + "\n".join(rows(row) for row in view.pose) for i, view in enumerate(views())]
    return Sample("open3d", {**files, "trajectory.log": lines(*log)})


def _senfunet() -> Sample:
    files = {"1/camera.json": camera_json()}
    for i, view in enumerate(views()):
        files[f"1/left_rgb/{i}.png"] = encoded(".png", view.color)
        for sensor in ("left_depth_gt", "left_depth_noise_5.0"):
            files[f"1/{sensor}/{i}.png"] = depth_png(view)
        files[f"1/left_camera_matrix/{i}.txt"] = matrix_text(view.pose)
    return Sample("senfunet", files)


def _replica() -> Sample:
    files = {"camera.json": camera_json(depth_scale=6553.5)}
    for i, view in enumerate(views()):
        files[f"results/frame{i:06d}.jpg"] = encoded(".jpg", view.color)
        files[f"results/depth{i:06d}.png"] = depth_png(view, 6553.5)
    return Sample("replica", {**files, "traj.txt": lines(*(rows(view.pose) for view in views()))})


def _seven_scenes() -> Sample:
    files = {"camera-intrinsics.txt": INTRINSICS}
    for i, view in enumerate(views()):
        name = f"seq-01/frame-{i:06d}"
        files[f"{name}.color.png"], files[f"{name}.depth.png"] = encoded(".png", view.color), depth_png(view)
        files[f"{name}.pose.txt"] = matrix_text(view.pose)
    return Sample("7scenes", files)


def _tum() -> Sample:
    files = {"calibration.txt": lines("50 52 31 24")}
    for view in views():
        files[f"rgb/{view.time:.6f}.png"] = encoded(".png", view.color)
        files[f"depth/{view.time + 0.01:.6f}.png"] = depth_png(view, 5000.0)
    for kind, lag in (("rgb", 0.0), ("depth", 0.01)):
        stamps = [f"{view.time + lag:.6f}" for view in views()]
        files[f"{kind}.txt"] = lines("# images", "# timestamp filename", *(f"{t} {kind}/{t}.png" for t in stamps))
    truth = [f"{view.time + lag:.4f} {rows(vector(view.pose))}" for view in views() for lag in (-0.01, 0.01)]
    return Sample("tum", {**files, "groundtruth.txt": lines("# timestamp tx ty tz qx qy qz qw", *truth)})


def _scannet() -> Sample:
    files = {"frames/intrinsic/intrinsic_depth.txt": INTRINSICS}
    for i, view in enumerate(views()):
        files[f"frames/color/{i}.jpg"], files[f"frames/depth/{i}.png"] = encoded(".jpg", view.color), depth_png(view)
        files[f"frames/pose/{i}.txt"] = matrix_text(view.pose)
    return Sample("scannet", files)
