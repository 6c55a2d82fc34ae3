"""Made data sets: scene, path, true mesh, files, and the command."""

import json
import shutil

import cv2
import numpy as np
import open3d as o3d
import pytest
from click.testing import CliRunner
from uncle.cli.main import main
from uncle.datasets import senfunet
from uncle.datasets.synth.corridor import HEIGHT_M, corridor, corridor_stations
from uncle.datasets.synth.path import CLEARANCE_M, MAX_STEP_M, MAX_TURN_DEG, FreeSpace, handheld_path, walk
from uncle.datasets.synth.render import Renderer
from uncle.datasets.synth.room import furnished_room
from uncle.datasets.synth.seen import subdivide
from uncle.datasets.synth.user_mesh import load_scene
from uncle.datasets.synth.write import SynthOptions, make_dataset, square_camera
from uncle.recon.core.errors import ConfigError, DataError, RunError
from uncle.recon.core.events import Progress
from uncle.recon.core.mesh import Mesh

SIZE = 96
CAMERA = square_camera(SIZE)
TOP, BOTTOM = (200, 40, 30), (30, 60, 210)  # the two colours of the test texture


@pytest.fixture(scope="module")
def room():
    return Renderer(furnished_room(0), CAMERA, np.random.default_rng(0))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    events = []
    out = tmp_path_factory.mktemp("synth") / "room"
    options = SynthOptions(frames=6, size_px=SIZE, seed=3, sensors=("sl", "tof", "sgm", "dense"))
    make_dataset(out, options, on_event=events.append)
    return out, events


def box_mesh_obj(folder):
    """A room of 4 x 4 x 3 m as an OBJ; its walls show the upper half of the texture above 1.5 m."""
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32], image[32:] = TOP, BOTTOM
    cv2.imwrite(str(folder / "skin.png"), image[..., ::-1])
    (folder / "box.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd skin.png\n")
    corners = [(-2, -2), (2, -2), (2, 2), (-2, 2)]
    lines = ["mtllib box.mtl", "usemtl skin"]
    lines += [f"v {x} {y} {z}" for z in (0, 3) for x, y in corners]
    lines += ["vt 0.5 0", "vt 0.5 1", "vt 0.5 0.1", "vt 0.5 0.9"]  # OBJ counts v from the bottom
    for k in range(4):
        a, b = k + 1, (k + 1) % 4 + 1
        lines += [f"f {a}/1 {b}/1 {b + 4}/2", f"f {a}/1 {b + 4}/2 {a + 4}/2"]
    lines += ["f 1/3 2/3 3/3", "f 1/3 3/3 4/3", "f 5/4 6/4 7/4", "f 5/4 7/4 8/4"]
    path = folder / "box.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def looking_along_x(z=1.5):
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    pose[:3, 3] = [0, 0, z]
    return pose


# --- scene and renderer ----------------------------------------------------------------------------
@pytest.mark.parametrize("seed", [0, 1, 2, 11])
def test_rooms_are_furnished_and_of_room_size(seed):
    scene = furnished_room(seed)
    low, high = scene.bounds
    assert 8 <= len(scene.contents) <= 16
    assert 4 <= high[0] - low[0] <= 6.1
    assert 4 <= high[1] - low[1] <= 6.1
    assert 2.5 <= high[2] <= 3.0
    assert np.isfinite(scene.uvs).all()
    assert scene.texture_ids.max() < len(scene.textures)


def test_rooms_differ_by_seed():
    assert len(furnished_room(1).faces) != len(furnished_room(2).faces)


def test_depth_is_that_of_the_wall_in_front(tmp_path):
    renderer = Renderer(load_scene(box_mesh_obj(tmp_path)), CAMERA, np.random.default_rng(0))
    depth = renderer.render(looking_along_x()).depth
    rays = CAMERA.rays().numpy()
    expected = np.minimum(2 / 1.0, 1.5 / np.maximum(np.abs(rays[..., 1]), 1e-9))
    np.testing.assert_allclose(depth, expected, rtol=1e-5)


def test_the_same_point_has_the_same_colour_in_both_eyes(room):
    """Away from edges and at equal distance, colours of a reprojected pixel agree to a few levels."""
    free = FreeSpace.find(room.raycaster, *room.scene.bounds)
    left_pose = handheld_path(free, 2, np.random.default_rng(5))[0]
    right_pose = left_pose.copy()
    right_pose[:3, 3] += 0.1 * left_pose[:3, 0]
    left, right = room.render(left_pose), room.render(right_pose)
    v, u = np.mgrid[:SIZE, :SIZE]
    target = u - CAMERA.fx * 0.1 / np.maximum(left.depth, 1e-6)
    found = (left.depth > 0) & (target >= 0)
    columns = np.broadcast_to(np.where(found, target, 0), (SIZE, SIZE)).astype(np.float32)
    moved = cv2.remap(right.color, columns, v.astype(np.float32), cv2.INTER_LINEAR)
    difference = np.abs(moved - left.color).max(axis=-1)[found]
    contrast = np.abs(left.color[:, 5:] - left.color[:, :-5]).max(axis=-1)
    assert np.median(difference) < 4
    assert np.median(difference) < 0.6 * np.percentile(contrast, 75)  # and not because everything is grey


def test_walls_give_features_but_not_everywhere(room):
    free = FreeSpace.find(room.raycaster, *room.scene.bounds)
    renderer = Renderer(room.scene, square_camera(256), np.random.default_rng(0))
    counts = [
        len(cv2.SIFT_create().detect(np.clip(renderer.render(pose).color, 0, 255).astype(np.uint8), None))
        for pose in handheld_path(free, 60, np.random.default_rng(1))[::20]
    ]
    assert min(counts) > 60


# --- a user's mesh ---------------------------------------------------------------------------------
def test_a_mesh_keeps_its_texture_the_right_way_up(tmp_path):
    renderer = Renderer(load_scene(box_mesh_obj(tmp_path)), CAMERA, np.random.default_rng(0))
    color = renderer.render(looking_along_x()).color
    upper, lower = color[SIZE // 4, SIZE // 2], color[3 * SIZE // 4, SIZE // 2]
    assert upper.argmax() == np.argmax(TOP)
    assert lower.argmax() == np.argmax(BOTTOM)
    np.testing.assert_allclose(upper / upper.max(), np.array(TOP) / max(TOP), atol=0.03)
    np.testing.assert_allclose(lower / lower.max(), np.array(BOTTOM) / max(BOTTOM), atol=0.03)


def test_a_mesh_keeps_its_vertex_colours(tmp_path):
    mesh = o3d.geometry.TriangleMesh.create_box(4, 4, 3).translate([-2, -2, 0])
    mesh.vertex_colors = o3d.utility.Vector3dVector(np.tile([[0.2, 0.8, 0.4]], (8, 1)))
    path = tmp_path / "box.ply"
    o3d.io.write_triangle_mesh(str(path), mesh)
    color = Renderer(load_scene(path), CAMERA, np.random.default_rng(0)).render(looking_along_x()).color
    center = color[SIZE // 2, SIZE // 2]
    np.testing.assert_allclose(center / center[1], [0.25, 1.0, 0.5], atol=0.02)


def test_a_mesh_with_y_up_is_turned(tmp_path):
    turned = load_scene(box_mesh_obj(tmp_path), up="y")
    assert turned.bounds[1][2] - turned.bounds[0][2] == pytest.approx(4)
    assert load_scene(tmp_path / "box.obj").bounds[1][2] == pytest.approx(3)


@pytest.mark.parametrize("name", ["absent.glb", "text.obj", "text.glb", "empty.ply"])
def test_what_is_no_mesh_is_refused(tmp_path, name):
    if name != "absent.glb":
        (tmp_path / name).write_text("not a mesh\n")
    with pytest.raises(DataError, match=name):
        load_scene(tmp_path / name)


def test_a_mesh_without_room_for_a_camera_is_refused(tmp_path):
    path = tmp_path / "cup.ply"
    o3d.io.write_triangle_mesh(str(path), o3d.geometry.TriangleMesh.create_sphere(0.1))
    with pytest.raises(DataError, match="free space"):
        make_dataset(tmp_path / "out", SynthOptions(mesh=path, frames=2, size_px=SIZE))
    assert not (tmp_path / "out").exists()


# --- path ------------------------------------------------------------------------------------------
def turns_deg(poses):
    relative = np.einsum("nji,njk->nik", poses[:-1, :3, :3], poses[1:, :3, :3])
    return np.degrees(np.arccos(np.clip((np.trace(relative, axis1=1, axis2=2) - 1) / 2, -1, 1)))


@pytest.mark.parametrize(("frames", "loops", "seed"), [(130, 0, 0), (130, 2, 1), (300, 1, 2), (40, 0, 3), (13, 1, 4)])
def test_paths_are_slow_clear_of_everything_and_proper_rotations(room, frames, loops, seed):
    free = FreeSpace.find(room.raycaster, *room.scene.bounds)
    poses = handheld_path(free, frames, np.random.default_rng(seed), loops)
    assert poses.shape == (frames, 4, 4)
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (frames, 1, 1)), atol=1e-9
    )
    assert (np.linalg.det(poses[:, :3, :3]) > 0).all()
    assert np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).max() <= MAX_STEP_M
    assert turns_deg(poses).max() <= MAX_TURN_DEG
    assert (poses[:, 2, 1] < 0).all()  # the image is upright: its y axis points down
    distance = room.raycaster.compute_distance(o3d.core.Tensor(poses[:, :3, 3].astype(np.float32))).numpy()
    assert distance.min() >= CLEARANCE_M
    low, high = room.scene.bounds
    assert (poses[:, :3, 3] > low).all()
    assert (poses[:, :3, 3] < high).all()


def test_a_long_path_looks_all_around(room):
    free = FreeSpace.find(room.raycaster, *room.scene.bounds)
    forward = handheld_path(free, 200, np.random.default_rng(0))[:, :2, 2]
    sectors = np.unique(np.floor(np.arctan2(forward[:, 1], forward[:, 0]) / (np.pi / 3)))
    assert len(sectors) >= 5


def test_a_corridor_is_closed_and_is_walked_from_end_to_end_clear_of_its_walls():
    renderer = Renderer(corridor(60.0, 0), square_camera(32), np.random.default_rng(0))
    low, high = renderer.scene.bounds
    np.testing.assert_allclose(high - low, [32.0, 32.0, HEIGHT_M], atol=0.01)  # 30 m to the east, 30 m to the north
    poses = walk(corridor_stations(60.0, np.random.default_rng(1)), 120, np.random.default_rng(2))
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert 54 < steps.sum() < 60
    assert steps.max() < 1.5 * np.median(steps)
    np.testing.assert_allclose(poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.eye(3)[None].repeat(120, 0),
                               atol=1e-9)  # fmt: skip
    assert FreeSpace(poses[:, :3, 3], renderer.raycaster, CLEARANCE_M).clear(poses[:, :3, 3])
    assert all((renderer.render(pose).depth > 0).all() for pose in poses[::12])


def test_loops_come_back_to_the_start(room):
    free = FreeSpace.find(room.raycaster, *room.scene.bounds)
    poses = handheld_path(free, 121, np.random.default_rng(6), loops=3)
    for stop in (40, 80, 120):
        assert np.linalg.norm(poses[stop, :3, 3] - poses[0, :3, 3]) < 0.02
        assert turns_deg(poses[[0, stop]])[0] < 2
    middle = np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1)
    turned = np.array([turns_deg(poses[[0, k]])[0] for k in range(len(poses))])
    for start in (0, 40, 80):
        assert middle[start : start + 40].max() > 0.15 or turned[start : start + 40].max() > 20


def test_a_long_path_with_loops_is_no_standing_still_and_does_not_jump_at_them(room):
    free = FreeSpace.find(room.raycaster, *room.scene.bounds)
    poses = handheld_path(free, 600, np.random.default_rng(7), loops=2)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps.sum() > 15
    assert steps.max() <= MAX_STEP_M
    assert turns_deg(poses).max() <= MAX_TURN_DEG
    near = np.flatnonzero(np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1) < 0.02)
    assert {0, 300, 599} <= set(near)


def test_loops_reach_the_written_poses(tmp_path):
    out = make_dataset(tmp_path / "loop", SynthOptions(frames=25, size_px=32, sensors=(), loops=2))
    recording = senfunet.read(out)
    home = recording.pose(0)
    for stop in (12, 24):
        assert np.linalg.norm(recording.pose(stop)[:3, 3] - home[:3, 3]) < 0.02
        assert turns_deg(np.stack([home, recording.pose(stop)]))[0] < 2
    assert max(np.linalg.norm(recording.pose(i)[:3, 3] - home[:3, 3]) for i in range(25)) > 0.04


# --- true mesh -------------------------------------------------------------------------------------
def test_subdivision_keeps_the_surface_and_bounds_the_edges():
    scene = furnished_room(0)
    corners = scene.vertices[scene.faces].astype(float)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    faces, barycentric = subdivide(scene, 0.25)
    small = np.einsum("tkc,tcx->tkx", barycentric, corners[faces])
    parts = np.linalg.norm(np.cross(small[:, 1] - small[:, 0], small[:, 2] - small[:, 0]), axis=1) / 2
    np.testing.assert_allclose(np.bincount(faces, parts, len(area)), area, rtol=1e-5)
    assert np.linalg.norm(small - np.roll(small, 1, axis=1), axis=2).max() <= 0.2501


def test_true_mesh_is_what_the_true_depth_saw(made):
    out, _ = made
    recording = senfunet.read(out)
    mesh = Mesh.load(out / "mesh_gt.ply")
    assert mesh.colors is not None
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(mesh.vertices), o3d.core.Tensor(mesh.faces.astype(np.uint32)))
    rays = recording.camera.rays().numpy()
    centers = mesh.vertices[mesh.faces].mean(axis=1)
    seen = np.zeros(len(centers), dtype=bool)
    for index in range(len(recording)):
        frame = recording[index]
        rotation, origin = frame.T_world_camera[:3, :3], frame.T_world_camera[:3, 3]
        depth = frame.depths["gt"].numpy()
        away = np.zeros_like(depth, dtype=bool)
        away[4:-4, 4:-4] = depth[4:-4, 4:-4] > 0  # triangles at the border have their centre outside
        points = (rays * depth[..., None])[away] @ rotation.T + origin
        distance = scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
        assert np.quantile(distance, 0.97) < 0.003  # the rest: triangles whose centre is hidden
        assert distance.max() < 0.1
        local = (centers - origin) @ rotation
        u, v = (SIZE / 2 * local[:, k] / np.maximum(local[:, 2], 1e-6) + CAMERA.cx for k in (0, 1))
        inside = (local[:, 2] > 0) & (u > -0.5) & (v > -0.5) & (u < SIZE - 0.5) & (v < SIZE - 0.5)
        pixel = np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)
        near = depth[pixel]
        local_spread = cv2.dilate(depth, np.ones((3, 3))) - cv2.erode(depth, np.ones((3, 3)))
        seen[np.flatnonzero(inside)[np.abs(near - local[inside, 2]) <= local_spread[pixel] + 0.01]] = True
    assert seen.mean() > 0.98  # nothing else is in the mesh


# --- files -----------------------------------------------------------------------------------------
def test_data_set_reads_back_with_all_sensors(made):
    out, events = made
    recording = senfunet.read(out)
    assert len(recording) == 6
    assert set(recording.sensors) == {"gt", "sl", "tof", "sgm", "dense"}
    assert recording.reference_mesh == out / "mesh_gt.ply"
    assert recording.camera == CAMERA
    assert Progress("synth", 6, 6) in events
    facts = json.loads((out / "synth.json").read_text())
    assert facts["parameters"]["seed"] == 3
    assert facts["sensors"]["left_depth_noise_1.0"].startswith("sl-handa")
    assert cv2.imread(str(out / "1/left_depth_gt/0.png"), cv2.IMREAD_UNCHANGED).dtype == np.uint16


def test_sensors_resemble_the_truth_in_the_order_of_their_quality(made):
    recording = senfunet.read(made[0])
    errors, known = {}, {}
    for name in ("sl", "tof", "sgm", "dense"):
        pairs = [(f.depths[name].numpy(), f.depths["gt"].numpy()) for f in (recording[i] for i in range(6))]
        both = np.concatenate([np.abs(d - g)[(d > 0) & (g > 0)] for d, g in pairs])
        errors[name] = np.median(both)
        known[name] = np.mean([np.mean(d[g > 0] > 0) for d, g in pairs])
    assert errors["sl"] < 0.015
    assert errors["tof"] < 0.015
    assert 0.02 < errors["sgm"] < 0.2  # a twentieth of a pixel at this size is centimetres
    assert 0.02 < errors["dense"] < 0.3
    assert known["sl"] > 0.6
    assert known["sgm"] > 0.6
    assert known["dense"] == 1.0


def files_of(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_same_seed_same_files_and_sensors_do_not_disturb_each_other(tmp_path, made):
    make_dataset(tmp_path / "a", SynthOptions(frames=6, size_px=SIZE, seed=3, sensors=("sgm", "sl")))
    again, first = files_of(tmp_path / "a"), files_of(made[0])
    again.pop("synth.json")
    assert again == {name: first[name] for name in again}
    make_dataset(tmp_path / "b", SynthOptions(frames=1, size_px=SIZE, seed=4, sensors=("sl",)))
    assert files_of(tmp_path / "b")["1/left_rgb/0.png"] != first["1/left_rgb/0.png"]


def test_overwrite_removes_the_old_data_set_and_nothing_else(tmp_path, made):
    out = tmp_path / "room"
    shutil.copytree(made[0], out)
    (out / "notes.txt").write_text("mine")
    with pytest.raises(RunError, match="--overwrite"):
        make_dataset(out, SynthOptions(frames=1, size_px=32))
    make_dataset(out, SynthOptions(frames=1, size_px=32, sensors=("sl-habitat",)), overwrite=True)
    assert (out / "notes.txt").read_text() == "mine"
    assert sorted(path.name for path in (out / "1").iterdir()) == [
        "left_camera_matrix", "left_depth_gt", "left_depth_noise_1.0", "left_rgb", "right_rgb",
    ]  # fmt: skip
    assert len(list((out / "1/left_rgb").iterdir())) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sensors": ("lidar",)}, "lidar.*choose from"),
        ({"sensors": ("sl", "sl-habitat")}, "variants of one sensor"),
        ({"frames": 0}, "frames"),
        ({"size_px": 8}, "size"),
        ({"frames": 10, "loops": 2}, "25 frames"),
        ({"up": "x"}, "up"),
        ({"corridor_m": 2.0}, "5 to 1000 m"),
        ({"corridor_m": 20.0, "loops": 1}, "neither"),
    ],
)
def test_bad_settings_are_named(tmp_path, arguments, message):
    with pytest.raises(ConfigError, match=message):
        make_dataset(tmp_path / "out", SynthOptions(**arguments))
    assert not (tmp_path / "out").exists()


# --- command ---------------------------------------------------------------------------------------
def test_command_makes_a_data_set(tmp_path):
    out = tmp_path / "room"
    arguments = ["synth", str(out), "--frames", "4", "--size", "96", "--sensors", "sl", "sgm", "--seed", "1"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    assert set(senfunet.read(out).sensors) == {"gt", "sl", "sgm"}
    again = CliRunner().invoke(main, arguments)
    assert again.exit_code == 1
    assert "--overwrite" in again.output
    assert "Traceback" not in again.output


def test_command_makes_a_corridor(tmp_path):
    arguments = ["synth", str(tmp_path / "out"), "--corridor", "8", "--frames", "2", "--size", "32", "--sensors", "sl"]
    assert CliRunner().invoke(main, arguments).exit_code == 0
    facts = json.loads((tmp_path / "out" / "synth.json").read_text())
    assert facts["parameters"]["corridor_m"] == 8
    assert facts["scene"]["kind"] == "procedural corridor"


def test_command_uses_a_mesh_of_the_user(tmp_path):
    path = box_mesh_obj(tmp_path)
    result = CliRunner().invoke(
        main, ["synth", str(tmp_path / "out"), "--mesh", str(path), "--frames", "2", "--size", "64"]
    )
    assert result.exit_code == 0, result.output
    mesh = Mesh.load(tmp_path / "out/mesh_gt.ply")
    for colour in (TOP, BOTTOM):
        assert (np.abs(mesh.colors.astype(int) - colour).max(axis=1) < 4).any()


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    for out in (tmp_path / "file", tmp_path / "file" / "room"):
        with pytest.raises(RunError, match="file"):
            make_dataset(out, SynthOptions(frames=1, size_px=32, mesh=box_mesh_obj(tmp_path)))


@pytest.mark.parametrize("mesh", ["absent.ply", "folder"])
def test_command_names_a_bad_mesh_in_one_line(tmp_path, mesh):
    (tmp_path / "folder").mkdir()
    result = CliRunner().invoke(main, ["synth", str(tmp_path / "out"), "--mesh", str(tmp_path / mesh)])
    assert result.exit_code == 1
    assert mesh in result.output
    assert len(result.output.strip().splitlines()) == 1
