"""A camera that is turned while it films: the background shows by how much; one that is carried is named."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import sentence
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.load import load_capture
from solver_backend.types import Cameras, JointSet
from solver_backend.videos.detect import assemble
from solver_backend.videos.detect.assemble import as_if_still, camera_turns
from solver_backend.videos.video_detections import VideoDetections
from tests.support.recordings import BALANCING_TRIAL

cv2 = pytest.importorskip("cv2")

WIDTH, HEIGHT, FOCAL, FRAMES = 640, 360, 500.0, 24
KEYPOINTS = JointSet.COCO_17.num_keypoints


def camera() -> Cameras:
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    size = np.array([[WIDTH, HEIGHT]])
    return Cameras(("cam01",), K[None], np.zeros((1, 5)), np.eye(3)[None], np.zeros((1, 3)), size)


def scene(seed: int = 0) -> np.ndarray:
    """Return a wall of blobs, three pictures wide."""
    rng = np.random.default_rng(seed)
    wall = rng.integers(0, 255, (HEIGHT // 8 * 3, WIDTH // 8 * 3, 3), dtype=np.uint8)
    return cv2.GaussianBlur(cv2.resize(wall, (3 * WIDTH, 3 * HEIGHT), interpolation=cv2.INTER_CUBIC), (0, 0), 1.5)


def turns(degrees: float) -> np.ndarray:
    """Return (F, 3) a pan there and partly back, with a little tilt and roll."""
    time = np.linspace(0.0, 1.0, FRAMES)
    return np.deg2rad(degrees) * np.stack([0.2 * time, np.sin(2.5 * time) - 0.1 * time, 0.05 * time], axis=1)


def filmed(rotations: np.ndarray, people: np.ndarray, carried: float = 0.0, zoom: float = 1.0) -> Iterator[np.ndarray]:
    """Yield pictures of the far wall, with a dark person whose middle lies at each frame's pixel."""
    wall, K = scene(), camera().K[0]
    shift = np.array([[1, 0, -WIDTH], [0, 1, -HEIGHT], [0, 0, 1.0]])
    time = np.linspace(0.0, 1.0, len(rotations))
    depth = np.where(np.arange(3 * WIDTH) // 40 % 2, 1.0, 2.5)
    for frame, rotation in enumerate(rotations):
        lens = K @ np.diag([1 + (zoom - 1) * time[frame]] * 2 + [1.0])
        picture = cv2.warpPerspective(wall, lens @ exp_so3(rotation) @ np.linalg.inv(K) @ shift, (WIDTH, HEIGHT))
        if carried:
            moved = (np.arange(WIDTH) + carried * time[frame] / depth[:WIDTH]).astype(np.float32)
            picture = cv2.remap(
                picture, np.tile(moved, (HEIGHT, 1)), np.repeat(np.arange(HEIGHT, dtype=np.float32)[:, None], WIDTH, 1),
                cv2.INTER_LINEAR,
            )  # fmt: skip
        x, y = people[frame].astype(int)
        picture[max(y - 60, 0) : y + 60, max(x - 20, 0) : x + 20] = 30
        yield picture


def seen(rotations: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Return (F, 2) where the turned camera sees what a still one sees there."""
    K = camera().K[0]
    rays = np.concatenate([still, np.ones((len(still), 1))], axis=1) @ np.linalg.inv(K).T
    now = np.einsum("fij,fj->fi", exp_so3(rotations), rays) @ K.T
    return now[:, :2] / now[:, 2:]


def detections(people: np.ndarray) -> VideoDetections:
    offsets = np.stack([np.linspace(-18, 18, KEYPOINTS), np.linspace(-58, 58, KEYPOINTS)], axis=1)
    xy = people[:, None, None] + offsets
    return VideoDetections(
        Path("pan.mp4"), "", "none", JointSet.COCO_17, (WIDTH, HEIGHT), np.arange(FRAMES) / 30.0, xy,
        np.ones(xy.shape[:-1]), np.zeros((FRAMES, 1), dtype=int),
    )  # fmt: skip


def walk() -> np.ndarray:
    return np.stack([np.linspace(200, 420, FRAMES), np.full(FRAMES, 190.0)], axis=1)


def test_turns_are_found_beside_a_walking_person() -> None:
    rotations = turns(6.0)
    people = seen(rotations, walk())
    found = camera_turns(detections(people), camera(), filmed(rotations, people))
    assert found is not None and found.explain
    assert np.rad2deg(np.abs(found.rotations - rotations)).max() < 0.12
    assert found.largest_deg == pytest.approx(np.rad2deg(np.linalg.norm(rotations, axis=1).max()), abs=0.1)


def test_detections_become_those_of_a_camera_that_stands_still() -> None:
    rotations = turns(6.0)
    people = seen(rotations, walk())
    given = detections(people)
    steadied, diagnostics = as_if_still(given, camera(), filmed(rotations, people))
    middle = steadied.xy[:, 0, KEYPOINTS // 2]
    assert np.abs(middle - walk()).max() < 1.5 < np.abs(people - walk()).max()
    assert [item.code for item in diagnostics] == ["camera_turns"]
    assert diagnostics[0].where.cameras == ("pan",) and diagnostics[0].values["size"] > 5


def test_a_camera_that_stands_still_changes_nothing() -> None:
    given = detections(walk())
    steadied, diagnostics = as_if_still(given, camera(), filmed(np.zeros((FRAMES, 3)), walk()))
    assert steadied is given and not diagnostics


@pytest.mark.parametrize("how", [{"carried": 60.0}, {"zoom": 1.3}])
def test_a_camera_that_is_carried_or_zoomed_is_named_and_nothing_is_changed(how: dict[str, float]) -> None:
    given = detections(walk())
    steadied, diagnostics = as_if_still(given, camera(), filmed(np.zeros((FRAMES, 3)), walk(), **how))
    assert steadied is given and [item.code for item in diagnostics] == ["camera_moves"]


def test_without_a_background_a_note_states_that_nothing_is_known() -> None:
    given = detections(walk())
    blank = (np.full((HEIGHT, WIDTH, 3), 90, np.uint8) for _ in range(FRAMES))
    assert camera_turns(given, camera(), blank) is None
    blank = (np.full((HEIGHT, WIDTH, 3), 90, np.uint8) for _ in range(FRAMES))
    steadied, diagnostics = as_if_still(given, camera(), blank)
    assert steadied is given and [item.code for item in diagnostics] == ["camera_turns"]


def plain_wall(shift_px: float) -> Iterator[np.ndarray]:
    """Yield a plain wall with four pictures on it, in a picture that moves to the side."""
    for frame in range(FRAMES):
        wall = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
        for x, y in ((60, 40), (150, 250), (480, 60), (540, 200)):
            cv2.rectangle(wall, (x, y), (x + 30, y + 40), (200, 180, 160), -1)
        way = np.array([[1.0, 0.0, shift_px * frame / (FRAMES - 1)], [0.0, 1.0, 0.0]])
        yield cv2.warpAffine(wall, way, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)


def test_a_few_corners_on_a_plain_wall_show_that_the_camera_is_still() -> None:
    given = detections(np.tile([320.0, 190.0], (FRAMES, 1)))
    still, nothing = as_if_still(given, camera(), plain_wall(0.0))
    assert still is given and not nothing
    _, diagnostics = as_if_still(given, camera(), plain_wall(20.0))
    assert [(item.code, item.values["turn"]) for item in diagnostics] == [("camera_turns", "unknown")]


def test_without_opencv_a_note_states_that_nothing_was_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    given, one = detections(walk()), camera()
    calibration = Calibration(one, Path("calib.toml"), (True,))
    (steadied,), [found] = assemble.steadied((given,), calibration)
    assert steadied is given and "OpenCV is not installed" in sentence(found)


REAL_FOCAL = 1500.0
"""Pixels of the recorded pictures: the turned camera sees them as a far plane, for which any focal length will do."""


def window_camera() -> Cameras:
    """Return the camera of a window of half the recorded scale, 5° narrower than the picture on each side."""
    K = np.array([[REAL_FOCAL / 2, 0, 200.0], [0, REAL_FOCAL / 2, 380.0], [0, 0, 1.0]])
    return Cameras(("cam01",), K[None], np.zeros((1, 5)), np.eye(3)[None], np.zeros((1, 3)), np.array([[400, 760]]))


def turned_pictures(path: Path, turns: np.ndarray) -> Iterator[np.ndarray]:
    """Yield pictures of a real video of a still camera as one that is turned sees them."""
    video, narrow = cv2.VideoCapture(str(path)), window_camera()
    for rotation in turns:
        there, picture = video.read()
        assert there
        wide = np.array([[REAL_FOCAL, 0, picture.shape[1] / 2], [0, REAL_FOCAL, picture.shape[0] / 2], [0, 0, 1.0]])
        H = narrow.K[0] @ exp_so3(rotation) @ np.linalg.inv(wide)
        yield cv2.cvtColor(cv2.warpPerspective(picture, H, (400, 760), flags=cv2.INTER_AREA), cv2.COLOR_BGR2RGB)


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_a_window_that_sways_over_a_real_video_is_a_camera_that_turns(shared_data: Path, number: int) -> None:
    trial, frames = shared_data / BALANCING_TRIAL, 60
    time = np.linspace(0.0, 1.0, frames)
    sway = np.deg2rad(4.5) * np.stack([0.3 * np.sin(9 * time), np.sin(4 * time), 0.1 * np.sin(6 * time)], axis=1)
    still = load_capture(trial).keypoints
    assert still is not None
    half = np.array([540.0 if number < 3 else 544.0, 960.0])
    rays = (still.xy[number - 1, :frames].astype(float) - half) / REAL_FOCAL
    rays = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
    now = np.einsum("fij,fkj->fki", window_camera().K[0] @ exp_so3(sway), rays)
    xy, sure = now[..., :2] / now[..., 2:], still.confidence[number - 1, :frames]
    people = VideoDetections(
        Path("pan.mp4"), "", "none", still.joint_set, (400, 760), np.arange(frames) / 60.0, xy[:, None],
        np.where(np.isfinite(xy).all(axis=-1), sure, 0.0)[:, None], np.zeros((frames, 1), dtype=int),
    )  # fmt: skip
    pictures = turned_pictures(trial / "videos" / f"cam0{number}.mp4", sway)
    found = camera_turns(people, window_camera(), pictures)
    assert found is not None and found.explain and found.largest_deg > 4.0
    assert np.rad2deg(np.linalg.norm(found.rotations - sway, axis=1)).max() < 0.15
