"""A path in any world becomes one in metres with Z up and the person's feet on the floor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.geometry.rotations import exp_so3, quat_from_matrix
from solver_backend.io.camera_paths import ESTIMATED, FilmedPath
from solver_backend.io.recognition.path_fit import UNSURE, fit_path, scale_by_feet
from solver_backend.io.recognition.world_fit import fit_world
from solver_backend.types import Cameras, Keypoints2D
from tests.support.carried_camera import Carried, film_person
from tests.support.floor_takes import FITTED, planted_steps
from tests.support.walking_take import EXACT

TURN, SCALE = exp_so3(np.array([0.4, 0.7, -0.3])), 0.37  # Of the file's world.


@pytest.fixture(scope="module")
def filmed() -> Carried:
    walker = planted_steps(FITTED[0], 0)
    person = walker.person.part(slice(0, 120))
    return film_person("walk", person, walker.fps, "hand-held", 0, EXACT, np.random.default_rng(0))


def parts(filmed: Carried) -> tuple[Cameras, Keypoints2D, np.ndarray]:
    """Return the camera without its path, the detections, and the camera's true places."""
    cameras, keypoints = filmed.capture.cameras, filmed.capture.keypoints
    assert cameras is not None and keypoints is not None
    return replace(cameras, path=None), keypoints, -np.einsum("fba,fb->fa", filmed.R, filmed.t)


def stated(filmed: Carried, centre: np.ndarray, **more: object) -> FilmedPath:
    known = {"metres": 0.0, "up": None, **more}
    return FilmedPath(TURN @ filmed.R.swapaxes(-1, -2), SCALE * centre @ TURN.T + 1.0, source="path.txt", **known)  # type: ignore[arg-type]


def test_up_and_floor_come_from_the_person(filmed: Carried) -> None:
    camera, keypoints, centre = parts(filmed)
    found, note = fit_path(camera, keypoints, stated(filmed, centre))
    R, t = found.poses(0, len(centre))
    off = np.degrees(np.arccos(np.clip((R[:, :, 2] * filmed.R[:, :, 2]).sum(-1), -1, 1)))
    height = -np.einsum("fba,fb->fa", R, t)[:, 2].mean()
    assert off.max() < 4.0 and abs(height - centre[:, 2].mean()) < 0.2
    assert note.code == "camera_moves" and "path.txt" in sentence(note)
    way, true = -np.einsum("fba,fb->fa", R, t), centre - centre[0]
    assert abs(np.linalg.norm(way[-1] - way[0]) / np.linalg.norm(true[-1]) - 1.0) < 0.05
    _, own = fit_path(camera, keypoints, replace(stated(filmed, centre), source=ESTIMATED))
    assert (own.values["path"], own.severity) == ("estimated", note.severity)


def test_stated_metres_and_up_are_kept_and_a_portrait_picture_is_turned(filmed: Carried) -> None:
    camera, keypoints, centre = parts(filmed)
    path = stated(filmed, centre, metres=1.0 / SCALE, up=TURN[:, 2])
    quarter = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])
    for R in (path.R, path.R @ quarter):
        found, note = fit_path(camera, keypoints, replace(path, R=R))
        R, t = found.poses(0, len(centre))
        np.testing.assert_allclose(R[:, :, 2], filmed.R[:, :, 2], atol=1e-6)
        places = -np.einsum("fba,fb->fa", R, t)
        np.testing.assert_allclose(
            np.linalg.norm(places - places[0], axis=1), np.linalg.norm(centre - centre[0], axis=1)
        )
        assert note.values["path"] == "metric" and note.severity.value == "note"


@pytest.mark.parametrize("carried_m_s", [0.6, 1.3])
def test_feet_that_stand_tell_the_scale(carried_m_s: float) -> None:
    rng, fps = np.random.default_rng(0), 30.0
    time = np.arange(90) / fps
    centre = np.stack([carried_m_s * time, -3.5 + 0 * time, 1.5 + 0 * time], axis=1)
    phase = (time[:, None] / 1.1 + [0.0, 0.5]) % 1.0
    stride = np.where(phase < 0.6, 0.0, (phase - 0.6) / 0.4)  # a foot stands for 60 % of the time
    ahead = 1.43 * (np.floor(time[:, None] / 1.1 + [0.0, 0.5]) + stride)
    feet = np.stack([ahead, [[0.1, -0.1]] + 0 * ahead, 0 * ahead], axis=-1)
    sight = np.tile([0.0, 1.0, 0.0], (90, 1))
    seen = feet - centre[:, None] + 0.01 * rng.normal(size=feet.shape)
    scale, sigma = scale_by_feet(seen, SCALE * (centre - centre[0]), sight, fps)
    assert abs(scale * SCALE - 1.0) < 0.025 and sigma < UNSURE
    _, unknown = scale_by_feet(seen, 0.0 * centre, sight, fps)
    assert np.isinf(unknown)


def test_a_file_gives_its_path_to_one_camera_alone(filmed: Carried, tmp_path: Path) -> None:
    camera, keypoints, centre = parts(filmed)
    path = stated(filmed, centre)
    rows = zip(path.centre, np.roll(np.asarray(quat_from_matrix(path.R)), -1, axis=1), strict=True)
    text = "\n".join(f"{n} {' '.join(f'{x:.9g}' for x in (*c, *q))}" for n, (c, q) in enumerate(rows))
    (tmp_path / "path.txt").write_text(text, encoding="utf-8")
    settings = WorldSettings(camera_path=str(tmp_path / "path.txt"))
    world = fit_world(camera, keypoints, settings)
    assert world.cameras.path is not None and world.from_person
    assert [item.code for item in world.found] == ["camera_moves"]
    again = fit_world(world.cameras, keypoints, WorldSettings())
    assert again.cameras is world.cameras
    two = Cameras(
        ("a", "b"), *(np.repeat(getattr(camera, n), 2, axis=0) for n in ("K", "distortion", "R", "t", "image_size"))
    )
    with pytest.raises(JobInvalid, match="used with one camera"):
        fit_world(two, keypoints, settings)
