import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from uncle.datasets import open_dataset
from uncle.datasets.clocks import Motion, Stream, best_delay, color_picture, depth_delay, depth_picture, motion

COUNT, RATE = 95, 30.0


def turning(times: np.ndarray) -> np.ndarray:
    """(N, 2) pixels by which a picture has moved: a shaking hand, no two seconds alike."""
    x = 14 * np.sin(5 * times) + 9 * np.sin(11.3 * times + 1)
    return np.stack([x, 11 * np.sin(6.1 * times + 2) + 6 * np.sin(13.7 * times)], 1)


def speeds(times: np.ndarray) -> np.ndarray:
    return (turning(times + 1e-4) - turning(times - 1e-4)) / 2e-4


@pytest.mark.parametrize("delay", [-0.04, 0.022, 0.05])
def test_delay_of_two_noisy_motions(delay):
    draw = np.random.default_rng(1)
    times = np.arange(90) / RATE
    seen = speeds(times + 0.011)
    late = 0.4 * speeds(times - delay)  # which moves less, as near things seen from another place do
    wrong = draw.random(len(times)) < 0.05
    late[wrong] = draw.normal(0, 300, (wrong.sum(), 2))
    pair = (Motion(times + 0.011, seen), Motion(times, late + draw.normal(0, 3, late.shape)))
    assert best_delay([pair]) == pytest.approx(delay, abs=0.007)


def test_no_delay_is_claimed_without_reason():
    draw = np.random.default_rng(2)
    times = np.arange(90) / RATE
    together = (Motion(times, speeds(times)), Motion(times, speeds(times) + draw.normal(0, 20, (90, 2))))
    assert best_delay([together]) == 0
    unrelated = (Motion(times, draw.normal(0, 9, (90, 2))), Motion(times, draw.normal(0, 9, (90, 2))))
    assert best_delay([unrelated]) == 0
    still = (Motion(times, np.zeros((90, 2))), Motion(times, np.zeros((90, 2))))
    assert best_delay([still]) == 0
    far = (Motion(times, speeds(times)), Motion(times, speeds(times - 0.2)))
    assert best_delay([far]) == 0, "beyond what is tried"
    slow = 30 * np.sin(np.outer(9 * times, [1, 0.7]) + np.array([0, 2]))
    for _ in range(5):
        shaky = [Motion(times, slow + draw.normal(0, 12, slow.shape)) for _ in range(3)]
        calm = [Motion(times, slow + draw.normal(0, 3, slow.shape)) for _ in range(3)]
        assert best_delay([*zip(shaky, calm, strict=True)]) == 0, "to smooth one of them is no delay"
    short = (Motion(times[:30], speeds(times[:30])), Motion(times[:30], speeds(times[:30] - 0.02)))
    assert best_delay([short]) == 0 == best_delay([])


@pytest.fixture
def shaken(tmp_path: Path):
    """Colour and depth of a patterned wall, seen by a shaking camera; depth is stamped `delay` late."""
    draw = np.random.default_rng(3)
    wall = cv2.GaussianBlur(draw.random((300, 360)).astype(np.float32), (0, 0), 1.5)
    wall = (wall - wall.min()) / (wall.max() - wall.min())

    def view(seconds: float) -> np.ndarray:
        x, y = turning(np.array([seconds]))[0]
        move = np.array([[1, 0, x - 100], [0, 1, y - 90]], np.float32)
        return cv2.warpAffine(wall, move, (160, 120), flags=cv2.INTER_LINEAR)

    def write(delay: float) -> Path:
        for stream in ("rgb", "depth"):
            (tmp_path / stream).mkdir()
        lines: dict[str, list[str]] = {"rgb": [], "depth": []}
        for n in range(COUNT):
            seconds = n / RATE
            stamps = {"rgb": seconds + 0.004, "depth": seconds + delay}
            cv2.imwrite(str(tmp_path / f"rgb/{n}.png"), (view(seconds + 0.004) * 255).astype(np.uint8))
            depth = (5000 * (1 + view(seconds))).astype(np.uint16)
            depth[draw.random(depth.shape) < 0.02] = 0
            cv2.imwrite(str(tmp_path / f"depth/{n}.png"), depth)
            for stream, stamp in stamps.items():
                lines[stream].append(f"{100 + stamp:.6f} {stream}/{n}.png")
        for stream, text in lines.items():
            (tmp_path / f"{stream}.txt").write_text("\n".join(text))
        return tmp_path

    return write


def streams(folder: Path) -> tuple[Stream, Stream]:
    table = {n: [line.split() for line in (folder / f"{n}.txt").read_text().splitlines()] for n in ("rgb", "depth")}
    color, depth = (
        Stream(np.array([float(t) for t, _ in rows]), [folder / f for _, f in rows]) for rows in table.values()
    )
    return color, depth


@pytest.mark.parametrize("delay", [0.0, 0.025])
def test_delay_of_images(shaken, delay):
    assert depth_delay(*streams(shaken(delay))) == pytest.approx(delay, abs=0.003 if delay else 0)


def test_slow_streams_and_gaps_tell_nothing(shaken):
    color, depth = streams(shaken(0.025))
    assert depth_delay(Stream(4 * color.times, color.files), Stream(4 * depth.times, depth.files)) == 0
    late = depth.times + 5 * (np.arange(COUNT) >= 30)
    assert len(motion(Stream(late, depth.files), late[0], depth_picture).times) == 43, "one of 44 took 5 seconds"


def test_motion_of_pictures_is_that_of_the_camera(shaken):
    color, depth = streams(shaken(0.0))
    for stream, read in ((color, color_picture), (depth, depth_picture)):
        found = motion(stream, 0.0, read)
        assert np.median(np.abs(found.velocities - speeds(found.times - 100))) < 12, "pixels per second, of up to 150"


def test_pairs_follow_the_delay_and_a_note_reports_it(shaken):
    folder = shaken(0.045)
    camera = {"width": 160, "height": 120, "fx": 130, "fy": 130, "cx": 79.5, "cy": 59.5, "depth_scale": 5000}
    (folder / "camera.json").write_text(json.dumps(camera))
    recording = open_dataset(folder)
    assert any("ms later than the colour that shows the same motion" in note for note in recording.notes)
    assert len(recording) == COUNT
    for index in range(COUNT):
        assert recording.timestamp(index) == pytest.approx(100.004 + index / RATE, abs=1e-5)
        stored = cv2.imread(str(folder / f"depth/{index}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(recording.depth(index, "depth").numpy(), stored / 5000, atol=1e-4)


def test_unreadable_images_and_clocks_apart_say_nothing(shaken):
    folder = shaken(0.025)
    color, depth = streams(folder)
    assert depth_delay(color, Stream(depth.times + 1e6, depth.files)) == 0
    for n in range(0, COUNT, 9):
        whole = (folder / f"depth/{n}.png").read_bytes()
        (folder / f"depth/{n}.png").write_bytes(whole[: len(whole) // 2])
    assert depth_delay(color, depth) == pytest.approx(0.025, abs=0.003)
    cv2.imwrite(str(folder / "depth/1.png"), np.ones((1, 160), np.uint16))
    cv2.imwrite(str(folder / "depth/2.png"), np.ones((120, 160, 3), np.uint16))
    assert depth_delay(color, depth) == pytest.approx(0.025, abs=0.003)
    for n in range(COUNT):
        (folder / f"rgb/{n}.png").unlink()
    assert depth_delay(color, depth) == 0
