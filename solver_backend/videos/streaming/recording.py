"""Record live cameras, and write the recording as a capture and a motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.events import FrameLine, LiveLine
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.live import recordings
from solver_backend.live.frames import ViewMoment
from solver_backend.live.views_session import ViewsSession
from solver_backend.types import NUM_BETAS, Cameras, Capture, JointSet, Keypoints2D
from solver_backend.videos.sync.clocks import at_times

_FORMAT, _VERSION = "manifold_mocap_live_views", 2
_TURNS = 3 * (1 + NUM_BODY_JOINTS)  # Rotation values per pose: rotation vectors of the root and the body joints.


@dataclass(frozen=True)
class ViewsRecording(recordings.RecordingFormat[[ViewMoment, FrameLine | None]]):
    """Recording of live cameras. It becomes the capture ``TAKE.npz`` and the motion ``TAKE_live.npz``.

    The capture contains the keypoints at a constant rate. The motion contains the live poses in the same frames, and a
    solve can start from them. Every row of the recording file contains the camera poses. The capture gets the camera
    poses of the last row, because the world may only be determined during the recording.
    """

    pieces: ClassVar[str] = "moments"
    session: ViewsSession | None = None  # Session to record. None to finish a recording of an earlier run.
    source: str = ""

    def head(self) -> bytes:
        """Return the header line of the recording file. It describes cameras, keypoints and body."""
        assert self.session is not None
        cameras = self.session.cameras
        arrays = {key: getattr(cameras, key).tolist() for key in ("K", "distortion", "image_size")}
        body, joint_set = self.session.fit.subject.body.id, self.session.joint_set.value
        described = {"names": cameras.names, "models": cameras.models, **arrays}
        return recordings.pack_head(_FORMAT, _VERSION, body=body, source=self.source, joint_set=joint_set, **described)

    def encode(self, moment: ViewMoment, line: FrameLine | None) -> bytes:
        """Encode a moment and its live pose as a row. Without a pose, the pose values are NaN."""
        session = self.session
        assert session is not None
        cameras, count = session.cameras, session.joint_set.num_keypoints
        unseen = np.full((len(cameras), count, 2), np.nan), np.zeros((len(cameras), count))
        pose = np.full(3 + _TURNS, np.nan)
        if line is not None and "trans" in line and "root" in line and "pose" in line:
            pose = np.array([*line["trans"], *line["root"], *line["pose"]])
        who = session.fit.subject.betas
        seen = session.chosen or unseen
        return recordings.pack_row([moment.time], moment.times, cameras.R, cameras.t, pose, who, *seen)

    def finish(self, recording: Path, path: Path, *, overwrite: bool = False, lost: int = 0) -> bool:
        """Convert a recording file to the capture and the live motion. Return whether it contains a person."""
        head, rows = recordings.read_rows(recording, _FORMAT, _VERSION, lambda head: sum(_widths(head)))
        rows = recordings.ascending_rows(rows, recording) if len(rows) else rows
        parts = np.split(rows, np.cumsum(_widths(head))[:-1], axis=1) if len(rows) else [np.zeros((0, 1))] * 8
        time_s, seen_s, R, t, poses, betas, xy, confidence = parts
        seen = bool((confidence > 0).any())
        if seen:
            cameras, joint_set = _cameras(head, R[-1], t[-1]), JointSet(head["joint_set"])
            C, K, time_s = len(cameras), joint_set.num_keypoints, time_s[:, 0]
            fps, frames = recordings.even_times(time_s)
            xy, confidence = xy.reshape(-1, C, K, 2), confidence.reshape(-1, C, K)
            views = [_view(seen_s[:, c], xy[:, c], confidence[:, c], frames) for c in range(C)]
            keypoints = Keypoints2D(np.stack([v[0] for v in views]), np.stack([v[1] for v in views]), joint_set, fps)
            note = diagnostic("detected_live", source=head["source"], file=motion_of(path).name)
            write_capture(path, Capture(path.stem, cameras, keypoints, notes=(note,)), overwrite=overwrite)
            posed = np.isfinite(poses).all(1)
            if posed.any():
                body = load_body()
                hands = np.zeros((len(rows), 3 * body.layout.num_joints - _TURNS))  # live poses contain no fingers
                found = np.concatenate([time_s[:, None], poses, hands], axis=1)[posed]
                motion = recordings.poses_at(frames, found, fps, betas[-1], body, head["source"])
                write_motion(motion_of(path), motion, overwrite=overwrite)
        recording.unlink()
        return seen


def run_recorded(
    session: ViewsSession, moment: ViewMoment, recorder: recordings.Recorder[[ViewMoment, FrameLine | None]] | None
) -> list[LiveLine]:
    """Solve a moment (simultaneous images), and record it with its pose if a recorder is given. Return output lines."""
    lines = list(session.run([moment]))
    if recorder is not None:
        recorder.add(moment, next((line for line in lines if "event" not in line), None))
    return lines


def motion_of(capture: Path) -> Path:
    """Return the path of the live motion that belongs to a recorded capture."""
    return capture.with_name(f"{capture.stem}_live.npz")


def _widths(head: dict[str, Any]) -> tuple[int, ...]:
    C, K = len(head["names"]), JointSet(head["joint_set"]).num_keypoints
    return 1, C, 9 * C, 3 * C, 3 + _TURNS, NUM_BETAS, 2 * C * K, C * K


def _cameras(head: dict[str, Any], R: np.ndarray, t: np.ndarray) -> Cameras:
    K, distortion, size = (np.array(head[key]) for key in ("K", "distortion", "image_size"))
    return Cameras(
        tuple(head["names"]), K, distortion, R.reshape(-1, 3, 3), t.reshape(-1, 3), size, tuple(head["models"])
    )


def _view(
    seen_s: np.ndarray, xy: np.ndarray, confidence: np.ndarray, frames: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Resample one view's detections at the frame times. Return pixels (F, K, 2) and confidences (F, K)."""
    there = np.flatnonzero(np.isfinite(seen_s))
    there = there[np.concatenate([[True], np.diff(seen_s[there]) > 1e-4])] if len(there) else there
    placed = partial(at_times, times_s=seen_s[there], wanted_s=frames)
    places, sureness = placed(xy[there]), placed(np.where(np.isfinite(xy[there]).all(-1), confidence[there], np.nan))
    known = np.isfinite(places).all(-1) & np.isfinite(sureness)
    return np.where(known[..., None], places, np.nan), np.where(known, sureness, 0.0)
