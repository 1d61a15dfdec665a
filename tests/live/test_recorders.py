"""Every recorder keeps what came from the first moment on, in whichever state the session ends."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.cli.live_verb import recorded
from solver_backend.io.markers.read import read_markers
from solver_backend.io.native.motion_file import read_motion
from solver_backend.live.face_source import FaceFrame, face_lines
from solver_backend.live.frames import PointFrame
from solver_backend.live.recordings import FaceRecording, PointsRecording, PosesRecording, Recorder, record_points
from solver_backend.live.session import LiveSession, person_fit
from solver_backend.live.vmc_source import BoneFrame, BonesOnBody, pose_lines

BODY = person_fit(None)[1].subject.landmarks.anchors.sum(axis=1)[:, [2, 0, 1]]


def frames(points: np.ndarray, count: int, step: float = 1e-4) -> list[PointFrame]:
    return [PointFrame(k / 60.0, points + step * k, time.perf_counter()) for k in range(count)]


@pytest.mark.parametrize(
    ("state", "came"),
    [
        ("waiting", frames(BODY[:5], 3)),
        ("waiting", frames(BODY, 2)),
        ("frozen", frames(BODY, 60, 0.0)),
        ("no_person", frames(np.random.default_rng(0).uniform(0.0, 1.8, (12, 3)) * (9.0, 0.1, 1.0), 30)),
        ("tracking", frames(BODY, 30)),
    ],
)
def test_points_are_recorded_in_every_state(tmp_path: Path, state: str, came: list[PointFrame]) -> None:
    known = {"unit": "m", "up_axis": "z"} if state == "no_person" else {}
    session, path = LiveSession(*person_fit(None), **known), tmp_path / "take.c3d"
    recorder = Recorder(path, PointsRecording(60.0, lambda: session.to_metres), overwrite=False)
    with recorder:
        lines: list[Any] = [line for line in session.run(record_points(came, recorder)) if "event" not in line]
    assert lines[-1]["state"] == state and len(lines) == len(came)
    assert len(read_markers(path).cloud.positions) == recorder.count == len(came)
    assert recorded(recorder) == {"recorded": str(path)}


def bones(number: int, names: tuple[str, ...]) -> BoneFrame:
    quat = {name: np.array([1.0, 0.0, 0.0, 0.0]) for name in names}
    root = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    return BoneFrame(number / 60.0, time.perf_counter(), quat, dict.fromkeys(names, np.zeros(3)), root, {})


@pytest.mark.parametrize("count", [1, 2, 30])
@pytest.mark.parametrize("names", [("Hips",), ("Hips", "LeftIndexProximal")])
def test_poses_are_recorded_from_the_first(tmp_path: Path, count: int, names: tuple[str, ...]) -> None:
    onto, path = BonesOnBody(load_body()), tmp_path / "take.npz"
    with Recorder(path, PosesRecording("test", onto.person), overwrite=False) as recorder:
        list(pose_lines((bones(k, names) for k in range(count)), onto, recorder))
    assert recorder.count == read_motion(path).num_frames == count


@pytest.mark.parametrize("unseen", [0, 3])
def test_faces_are_recorded_from_the_first_that_is_seen(tmp_path: Path, unseen: int) -> None:
    path = tmp_path / "face.csv"
    found = [FaceFrame(k / 60.0, 0.0, {"jawOpen": 0.5} if k >= unseen else {}) for k in range(unseen + 1)]
    with Recorder(path, FaceRecording(), overwrite=False) as recorder:
        assert len(list(face_lines(found, recorder))) == unseen + 1
    assert path.read_text().splitlines() == ["time,jawOpen", f"{unseen / 60.0:.6f},0.5000"]


@pytest.mark.parametrize(("name", "form"), [("a.c3d", PointsRecording()), ("a.npz", PosesRecording()),
                                            ("a.csv", FaceRecording())])  # fmt: skip
def test_a_run_in_which_nothing_came_is_named(tmp_path: Path, name: str, form: Any) -> None:
    with Recorder(tmp_path / name, form, overwrite=False) as recorder:
        pass
    assert recorded(recorder) == {"not_recorded": str(tmp_path / name)} and not list(tmp_path.iterdir())
