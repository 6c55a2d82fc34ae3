import pytest
from uncle.datasets.intrinsics import fit_camera
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError

VGA = Camera(640, 480, 525.0, 520.0, 319.5, 239.5)


def of_size(width: int, height: int, camera: Camera = VGA) -> Camera:
    """The numbers of `camera`, taken for those of images of another size."""
    return Camera(width, height, camera.fx, camera.fy, camera.cx, camera.cy)


@pytest.mark.parametrize(
    "camera", [VGA, Camera(640, 480, 517.3, 516.5, 318.6, 255.3), Camera(1200, 680, 600.0, 600.0, 599.5, 339.5),
               Camera(640, 480, 570.0, 572.0, 300.0, 220.0)],
)  # fmt: skip
def test_good_intrinsics_stay(camera):
    fitted = fit_camera(camera, (camera.width, camera.height), "images")
    assert (fitted.camera, fitted.notes) == (camera, ())


@pytest.mark.parametrize("size", [(320, 240), (1280, 960), (160, 120)])
def test_the_principal_point_tells_the_size_of_the_image(size):
    fitted = fit_camera(of_size(*size), size, "images")
    expected = VGA.resized(*size)
    assert fitted.camera.to_dict() == pytest.approx(expected.to_dict(), rel=1e-3)
    assert "are those of images of 640x480" in fitted.notes[0]


def test_a_stated_size_of_the_same_shape_is_scaled():
    fitted = fit_camera(VGA, (320, 240), "images")
    assert fitted.camera == VGA.resized(320, 240)
    assert "scaled by 0.5" in fitted.notes[0]


def test_a_real_calibration_of_another_mode_is_scaled():
    hd = Camera(1280, 720, 921.5, 920.8, 641.0, 357.2)
    fitted = fit_camera(of_size(848, 480, hd), (848, 480), "images")
    assert fitted.camera.fx == pytest.approx(921.5 * 848 / 1280, rel=0.01)
    assert fitted.camera.cx == pytest.approx(423.5, abs=4)


@pytest.mark.parametrize(
    ("camera", "size", "message"),
    [
        (VGA, (640, 360), "another shape"),
        (of_size(848, 240), (848, 240), "principal point cx 319.5, cy 239.5 is not near the middle"),
        (Camera(640, 480, 525, 525, 900.0, 239.5), (640, 480), "principal point"),
        (Camera(640, 480, 525, 525, -3.0, 239.5), (640, 480), "principal point"),
        (Camera(640, 480, 0.82, 1.09, 0.5, 0.5), (640, 480), "in pixels"),
        (Camera(96, 96, 0.5, 0.5, 0.5, 0.5), (96, 96), "in pixels"),
        (Camera(640, 480, 3.9, 3.9, 319.5, 239.5), (640, 480), "must be in pixels, not millimetres"),
    ],
)
def test_intrinsics_that_cannot_be_those_of_the_images_are_refused(camera, size, message):
    with pytest.raises(DataError, match=message):
        fit_camera(camera, size, "images")


def test_a_crop_is_questioned():
    fitted = fit_camera(of_size(640, 360), (640, 360), "images")
    assert fitted.camera == of_size(640, 360)
    assert fitted.notes[0].endswith("is it right?")
