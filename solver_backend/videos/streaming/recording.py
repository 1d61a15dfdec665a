"""Recording cameras while they are live: keypoints, times and poses as they come, a capture and a motion at the end."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import FileDamaged, MocapError
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.exchange.live_lines import FrameLine
from solver_backend.exchange.outputs import check_output
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.live.pose_recording import poses_at, rate_of
from solver_backend.live.recorder import Recorder
from solver_backend.live.views_session import ViewMoment, ViewsSession
from solver_backend.types import NUM_BETAS, Cameras, Capture, JointSet, Keypoints2D
from solver_backend.videos.sync.resample import at_times

_FORMAT, _VERSION = "manifold_mocap_live_views", 1
_TURNS = 3 * (1 + NUM_BODY_JOINTS)
"""Numbers of a pose: axis-angles of the root and the body's joints."""


class ViewsRecorder(Recorder):
    """Appends every moment to ``TAKE.npz.recording``; makes ``TAKE.npz`` and ``TAKE_live.npz`` of it at the end.

    The first is a capture of the keypoints at one rate, the second the live poses at the same frames, for a solve to
    start from; a context manager.
    """

    def __init__(self, path: Path, session: ViewsSession, source: str, *, overwrite: bool) -> None:
        """Begin a recording; what a run that was killed has left is finished under a name of its own.

        Raises:
            OutputExists, OutputNotWritable: it cannot be written, or another process records to it.
        """
        check_output(motion_of(path), overwrite=overwrite)
        super().__init__(path, finish_views, "moments", overwrite=overwrite)
        self._session, self._source = session, source

    @property
    def count(self) -> int:
        """Number of moments in the file."""
        return max(self._file.written - 1, 0)

    def add(self, moment: ViewMoment, line: FrameLine | None) -> None:
        """Append a moment, and the line that was made of it; moments before the world is known are left out."""
        session = self._session
        if not session.is_in_world or session.chosen is None:
            return
        if self._file.written == 0 and self._file.lost == 0:
            self._file.append(json.dumps(_head(session, self._source)).encode() + b"\n")
        xy, confidence = session.chosen
        pose = np.full(3 + _TURNS, np.nan)
        if line is not None and "trans" in line and "root" in line and "pose" in line:
            pose = np.array([*line["trans"], *line["root"], *line["pose"]])
        parts = [[moment.time], moment.times, pose, session.fit.subject.betas, xy.ravel(), confidence.ravel()]
        self._file.append(np.concatenate(parts).astype("<f8").tobytes())


def motion_of(capture: Path) -> Path:
    """Return where the live poses of a recorded capture are."""
    return capture.with_name(f"{capture.stem}_live.npz")


def finish_views(recording: Path, path: Path, *, overwrite: bool = False) -> bool:
    """Write a recording of views as a capture and the live motion and remove it; return whether it had moments.

    Raises:
        FileDamaged: it is none, or of another body than the one that ships.
        OutputExists, OutputNotWritable: they cannot be written; the recording is kept.
    """
    head, line, content = recording.read_bytes().partition(b"\n")
    count = 0
    if line:
        cameras, joint_set, source = _read_head(head, recording)
        C, K = len(cameras.names), joint_set.num_keypoints
        widths = (1, C, 3 + _TURNS, NUM_BETAS, 2 * C * K, C * K)
        count = len(content) // (8 * sum(widths))
        rows = np.frombuffer(content[: 8 * sum(widths) * count], "<f8").reshape(count, -1)
        if count:
            time_s, seen_s, poses, betas, xy, confidence = np.split(rows, np.cumsum(widths)[:-1], axis=1)
            time_s, fps = time_s[:, 0], rate_of(time_s[:, 0])
            frames = time_s[0] + np.arange(round((time_s[-1] - time_s[0]) * fps) + 1) / fps
            xy, confidence = xy.reshape(count, C, K, 2), confidence.reshape(count, C, K)
            views = [_view(seen_s[:, c], xy[:, c], confidence[:, c], frames) for c in range(C)]
            keypoints = Keypoints2D(
                np.stack([v[0] for v in views]), np.stack([v[1] for v in views]), joint_set, fps
            )  # fmt: skip
            note = diagnostic("detected_live", source=source, file=motion_of(path).name)
            write_capture(path, Capture(path.stem, cameras, keypoints, notes=(note,)), overwrite=overwrite)
            posed = np.isfinite(poses).all(1)
            if posed.any():
                body = load_body()
                hands = np.zeros((count, 3 * body.layout.num_joints - _TURNS))  # which live does not turn
                found = np.concatenate([time_s[:, None], poses, hands], axis=1)[posed]
                motion = poses_at(frames, found, fps, betas[-1], body, source)
                write_motion(motion_of(path), motion, overwrite=overwrite)
    recording.unlink()
    return count > 0


def _view(
    seen_s: np.ndarray, xy: np.ndarray, confidence: np.ndarray, frames: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return one view's (F, K, 2) px and (F, K) confidence at even times; missing where it was left out for long."""
    there = np.flatnonzero(np.isfinite(seen_s))
    there = there[np.concatenate([[True], np.diff(seen_s[there]) > 1e-4])] if len(there) else there
    placed = partial(at_times, times_s=seen_s[there], wanted_s=frames)
    places, sureness = placed(xy[there]), placed(np.where(np.isfinite(xy[there]).all(-1), confidence[there], np.nan))
    known = np.isfinite(places).all(-1) & np.isfinite(sureness)
    return np.where(known[..., None], places, np.nan), np.where(known, sureness, 0.0)


def _head(session: ViewsSession, source: str) -> dict[str, object]:
    cameras = session.cameras
    return {
        "format": _FORMAT, "version": _VERSION, "body": session.fit.subject.body.id, "source": source,
        "joint_set": session.joint_set.value, "names": cameras.names, "distortion_models": cameras.models,
        **{key: getattr(cameras, key).tolist() for key in ("K", "distortion", "R", "t", "image_size")},
    }  # fmt: skip


def _read_head(head: bytes, recording: Path) -> tuple[Cameras, JointSet, str]:
    """Return cameras, joint set and source of a recording.

    Raises:
        FileDamaged: it is none, or of another body.
    """
    try:
        found = json.loads(head)
        if found["format"] == _FORMAT and found["version"] == _VERSION and found["body"] == load_body().id:
            arrays = {key: np.array(found[key]) for key in ("K", "distortion", "R", "t", "image_size")}
            cameras = Cameras(names=tuple(found["names"]), models=tuple(found["distortion_models"]), **arrays)
            return cameras, JointSet(found["joint_set"]), str(found["source"])
    except (ValueError, KeyError, TypeError, MocapError):
        pass
    raise FileDamaged("The recording of views cannot be read, or is of another body.", where=str(recording))
