"""Pictures of scenes whose every pixel is known."""

import json

import numpy as np
import pytest
from matplotlib import colormaps
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import ConfigError, DataError, DependencyError
from uncle.recon.core.events import Note, Warn
from uncle.recon.core.files import write_text
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.mesh_raycaster import Surface
from uncle.recon.visualization import mesh_pictures as snapshot
from uncle.recon.visualization import offscreen
from uncle.recon.visualization.mesh_pictures import RENDERERS, draw_mesh, snapshot_views
from uncle.recon.visualization.shading import Geometry, light_triangles
from uncle.recon.visualization.views import View, guess_up, mesh_views, run_views, spread_poses, trajectory_up

CAMERA = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)
BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
     [1, 3, 5], [3, 7, 5]], dtype=np.int32,
)  # fmt: skip


def box(center, half, color=(255, 0, 0), inward=False) -> Mesh:
    """A cube of side 2 `half` with fronts outside, or `inward`."""
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    vertices = (np.array(center) + half * signs).astype(np.float32)
    faces = BOX_FACES[:, ::-1] if inward else BOX_FACES
    return Mesh(vertices, faces.copy(), np.tile(np.array(color, np.uint8), (8, 1)), np.full(8, 0.02, np.float32))


def looking_ahead(cut="back") -> View:
    return View("ahead", "ahead", CAMERA, np.eye(4), cut)


@pytest.fixture(params=["raycast", "offscreen"])
def renderer(request):
    if request.param == "offscreen" and not offscreen.is_available():
        pytest.skip("Open3D's OffscreenRenderer does not run here")
    return request.param


def picture(mesh, mode, renderer="raycast", view=None, reference=None):
    (drawn,) = draw_mesh(mesh, [view or looking_ahead()], [mode], reference, renderer)
    assert drawn.renderer == renderer
    return drawn.pictures[0]


def test_box_is_red_and_as_large_as_projected(renderer):
    image = picture(box((0, 0, 2.0), 0.25), "color", renderer)
    assert image.shape == (120, 160, 3)
    np.testing.assert_allclose(image[60, 80], [255, 0, 0], atol=2)
    covered = image[..., 1] < 128  # more than half of the pixel
    side = 2 * 0.25 * CAMERA.fx / 1.75  # the front face is at 1.75 m
    for axis in (0, 1):
        assert covered.any(axis).sum() == pytest.approx(side, abs=1.5)
        assert np.flatnonzero(covered.any(axis)).mean() == pytest.approx((CAMERA.cx, CAMERA.cy)[axis], abs=0.6)


def test_off_centre_box_is_where_the_camera_projects_it(renderer):
    image = picture(box((0.4, -0.2, 2.0), 0.05), "color", renderer)
    rows, columns = np.nonzero((image[..., 0] > 150) & (image[..., 1] < 150))
    assert columns.mean() == pytest.approx(0.4 / 1.95 * 120 + 79.5, abs=1.5)
    assert rows.mean() == pytest.approx(-0.2 / 1.95 * 120 + 59.5, abs=1.5)


def test_renderers_agree_in_every_view_and_mode():
    if not offscreen.is_available():
        pytest.skip("Open3D's OffscreenRenderer does not run here")
    room, thing = box((0, 0, 0), 2.0, (90, 160, 90), inward=True), box((0.8, 0.3, -1.2), 0.4)
    mesh = Mesh(
        np.concatenate([room.vertices, thing.vertices]), np.concatenate([room.faces, thing.faces + 8]),
        np.concatenate([room.colors, thing.colors]),
    )  # fmt: skip
    views = mesh_views(mesh.vertices, mesh.faces, (160, 120))
    modes = ["shaded", "color"]
    for first, second in zip(*(draw_mesh(mesh, views, modes, None, name) for name in RENDERERS[1:]), strict=True):
        for one, other in zip(first.pictures, second.pictures, strict=True):
            difference = np.abs(one.astype(int) - other).max(-1)
            assert np.median(difference) <= 1
            assert (difference > 40).mean() < 0.02, "more than edges differ"


@pytest.mark.parametrize(("inward", "cut"), [(True, "back"), (False, "front")])
def test_mesh_that_is_inside_out_is_shown_all_the_same(box_room, inward, cut):
    room = box((2.0, 1.5, 1.25), 1.5, inward=inward)
    poses = np.array([box_room.pose(angle) for angle in (0, 1, 2, 3)])
    views = run_views(poses, box_room.camera, room.vertices, room.faces, (64, 48))
    assert {view.cut for view in views} == {cut}
    assert all((picture(room, "color", view=view)[24, 32] != 255).any() for view in views)


def test_error_picture_shows_the_colour_of_two_centimetres(renderer):
    mesh, truth = box((0, 0, 2.0), 0.25), box((0, 0, 2.02), 0.25)
    np.testing.assert_allclose(Surface(truth).distance(np.array([[0, 0, 1.75]])), 0.02, atol=1e-5)
    image = picture(mesh, "error", renderer, reference=truth)
    expected = np.array(colormaps["RdYlBu_r"](0.02 / 0.05)[:3]) * 255
    np.testing.assert_allclose(image[60, 80], expected, atol=3)


def test_confidence_scale_ends_at_the_largest_common_value():
    drawn = draw_mesh(box((0, 0, 2.0), 0.25), [looking_ahead()], ["sigma"], None, "raycast")[0]
    assert drawn.scale.high == pytest.approx(0.02)
    expected = np.array(colormaps["viridis_r"](1.0)[:3]) * 255
    np.testing.assert_allclose(drawn.pictures[0][60, 80], expected, atol=3)


def test_room_is_seen_from_outside_through_its_near_walls():
    room = box((0, 0, 3.0), 1.0, inward=True)
    lit = light_triangles(Geometry.build(room.vertices, room.faces), looking_ahead())
    depths = room.vertices[lit.faces][..., 2]
    assert not (depths == 2.0).all(1).any()  # the near wall
    assert (depths == 4.0).all(1).sum() == 2  # the far wall


def test_slanted_surfaces_are_darker():
    front = picture(box((0, 0, 2.0), 0.25), "shaded")[60, 80]
    corner = np.eye(4)
    corner[:3, :3] = [[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]]
    corner[:3, 3] = np.array([0, 0, 2.0]) - 2.0 * corner[:3, 2]
    slanted = picture(box((0, 0, 2.0), 0.25), "shaded", view=View("s", "s", CAMERA, corner))
    assert (slanted[60, 78:82] < front.astype(int) - 15).all()


@pytest.mark.parametrize(("inward", "scale"), [(False, 0.3), (True, 3.0), (False, 50.0)])
def test_views_around_frame_the_whole_mesh(inward, scale):
    mesh = box((5.0, -3.0, 1.0), scale, inward=inward)
    views = mesh_views(mesh.vertices, mesh.faces, (160, 120))
    assert len(views) == 4
    for view in views:
        covered = (picture(mesh, "color", view=view) != 255).any(-1)
        assert not covered[[0, -1]].any()
        assert not covered[:, [0, -1]].any()
        assert max(covered.any(0).sum() / 160, covered.any(1).sum() / 120) > 0.6


def test_views_of_a_run_come_from_its_cameras(make_box_run, box_room):
    run = make_box_run()
    mesh = box_room.mesh()
    views = snapshot_views(mesh, run, (160, 120))
    assert [view.name.split("_")[0] for view in views] == ["frame", "frame", "frame", "overview"]
    assert views[-1].T_world_camera[2, 3] > mesh.vertices[:, 2].max(), "the overview looks from above the room"


def test_views_of_a_run_show_the_room_and_not_a_frame_kilometres_away(make_box_run, box_room):
    run = make_box_run()
    expected = snapshot_views(box_room.mesh(), run, (160, 120))
    records = json.loads(run.frames_path.read_text())
    records[5]["T_world_camera"][0][3] += 5000.0
    write_text(run.frames_path, json.dumps(records))
    room = box_room.mesh()
    vertices = np.concatenate([room.vertices, room.vertices + np.float32([5000, 0, 0])])
    mesh = Mesh(vertices, np.concatenate([room.faces, room.faces + len(room.vertices)]))
    overview = snapshot_views(mesh, run, (160, 120))[-1]
    assert np.abs(overview.T_world_camera[:3, 3] - expected[-1].T_world_camera[:3, 3]).max() < 5.0


def test_up_of_a_turning_level_camera(box_room):
    poses = np.array([box_room.pose(angle) for angle in np.linspace(0, 5, 9)])
    pitch = np.eye(4)
    pitch[1:3, 1:3] = [[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]]
    np.testing.assert_allclose(trajectory_up(poses), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(trajectory_up(poses @ pitch), [0, 0, 1], atol=1e-6)


def test_up_of_a_mesh_is_where_its_floor_looks():
    floor = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 3, 2]])  # fronts towards +y
    np.testing.assert_array_equal(guess_up(floor, faces), [0, 1, 0])


def test_poses_are_spread(box_room):
    poses = np.array([box_room.pose(angle) for angle in (0, 0.01, 0.02, np.pi, np.pi + 0.01)])
    assert spread_poses(poses, 2) == [0, 3]
    assert spread_poses(poses[:1], 3) == [0]


def test_what_is_missing_is_named():
    plain = Mesh(*(getattr(box((0, 0, 2), 1), name) for name in ("vertices", "faces")))
    for mode, word in (("color", "colours"), ("sigma", "uncle mesh"), ("error", "--gt")):
        with pytest.raises(DataError, match=word):
            draw_mesh(plain, [looking_ahead()], [mode], None, "raycast")
    with pytest.raises(ConfigError, match="shaded, color"):
        draw_mesh(plain, [looking_ahead()], ["wire"], None, "raycast")


def test_ray_caster_takes_over_and_says_so(monkeypatch):
    def refuse(*_):
        raise DependencyError("no driver")

    monkeypatch.setattr(offscreen, "is_available", lambda: True)
    monkeypatch.setattr(offscreen, "render", refuse)
    events = []
    drawn = snapshot.draw_mesh(box((0, 0, 2), 0.2), [looking_ahead()], ["shaded"], on_event=events.append)
    assert drawn[0].renderer == "raycast"
    assert any(isinstance(event, Warn) and "no driver" in event.text for event in events)
    assert any(isinstance(event, Note) and "ray caster" in event.text for event in events)


def test_a_renderer_that_dies_or_hangs_is_a_dependency_error(monkeypatch):
    geometry = Geometry.build(box((0, 0, 2), 0.2).vertices, BOX_FACES)
    monkeypatch.setattr(offscreen.sys, "executable", "/bin/false")
    with pytest.raises(DependencyError, match="mesa-vulkan-drivers"):
        offscreen.render(geometry, [], [looking_ahead()])


def test_sheets_and_single_pictures_are_written(tmp_path):
    mesh = box((0, 0, 2), 0.2)
    views = mesh_views(mesh.vertices, mesh.faces, (64, 48))
    for drawn in draw_mesh(mesh, views, None, mesh, "raycast"):
        assert drawn.save(tmp_path).read_bytes().startswith(b"\x89PNG")
    assert {path.stem for path in tmp_path.glob("*.png")} == {"shaded", "color", "sigma", "error"}
    assert len(list((tmp_path / "views").glob("*.png"))) == 16
