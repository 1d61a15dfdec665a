"""Record live runs frame by frame: points to C3D, poses to a motion file, and faces to a table."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, ClassVar, Generic, ParamSpec, Self, final

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.hands import FIRST_FINGER, with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.errors import FileDamaged, MocapError, OutputNotWritable
from solver_backend.exchange.motion_file import FLAG_UNSEEN
from solver_backend.exchange.outputs import check_output, is_held, lock, write_text
from solver_backend.exchange.plausible import FARTHEST_M, LARGEST_TURN, LONGEST_S
from solver_backend.exchange.so3 import quat_from_rotvec, rotvec_from_quat, sign_continuous
from solver_backend.fitters.motion_import.import_motion import standing_feet
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.files import open_appended
from solver_backend.io.markers.c3d import C3dSize, unnamed_labels, write_c3d_parts
from solver_backend.io.markers.live_recording import SUFFIX, LiveBlock, measure_recording, pack_block, read_parts
from solver_backend.io.native.motion_file import write_motion
from solver_backend.live.frames import PointFrame
from solver_backend.types import Motion

Item = ParamSpec("Item")
_AGAIN = "Record again. The unfinished recording was kept."


class RecordingFormat(ABC, Generic[Item]):
    """Format of a recording: converts frames to bytes, and a complete recording to a file."""

    pieces: ClassVar[str]

    def head(self) -> bytes:
        """Return the bytes that precede the first frame in a recording."""
        return b""

    @abstractmethod
    def encode(self, *args: Item.args, **kwargs: Item.kwargs) -> bytes:
        """Encode one frame as bytes."""

    @abstractmethod
    def finish(self, recording: Path, path: Path, *, overwrite: bool = False, lost: int = 0) -> bool:
        """Convert a recording to a file, then remove the recording. Return whether it had any frames.

        Raises:
            FileDamaged: the recording is not in this format.
        """


@final
class Recorder(Generic[Item]):
    """Context manager that appends frames to ``PATH.recording`` and converts it to ``PATH`` at the end.

    No frame is lost if the process is killed. The next run that uses the same path completes the recording.
    """

    def __init__(self, path: Path, form: RecordingFormat[Item], *, overwrite: bool) -> None:
        # Do this first. A run killed while it finished leaves both files, and check_output would reject this path.
        self.recovered = recover(path, form.finish)
        self.path = check_output(path, overwrite=overwrite)
        self.unfinished = recording_of(self.path)
        self._form, self._overwrite = form, overwrite
        self._file = open_appended(self.unfinished, fresh=True)
        lock(self._file.handle)
        self.finished = False

    @property
    def count(self) -> int:
        """Number of frames in the recording."""
        return self._file.written

    def add(self, *args: Item.args, **kwargs: Item.kwargs) -> None:
        """Append a frame. Frames that cannot be written are counted and reported at the end."""
        piece = self._form.encode(*args, **kwargs)
        self._file.append(piece if self._file.written else self._form.head() + piece)

    def finish(self) -> None:
        """Write the file if any frame was recorded, and remove the unfinished recording."""
        if self.finished:
            return
        self.finished = True
        self._file.close()
        self._form.finish(self.unfinished, self.path, overwrite=self._overwrite, lost=self._file.lost)
        hint = f"The other {self._form.pieces} are in {self.path.name}. Free disk space before the next recording."
        self._file.require_whole(hint)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with suppress(MocapError) if kind is not None else nullcontext():
            self.finish()


def recording_of(path: Path) -> Path:
    """Return the path of the unfinished recording for an output file."""
    return path.with_name(path.name + SUFFIX)


def recover(path: Path, finish: Callable[[Path, Path], bool]) -> Path | None:
    """Complete the recording of a run that was killed. Return the new file, or None if there is no recording.

    Raises:
        OutputNotWritable: another process is recording, or the disk is full. The recording is not deleted.
    """
    left = recording_of(path)
    if not left.exists():
        return None
    if is_held(left):
        raise OutputNotWritable("Another process is recording to this file.", where=str(path), hint="Change the name.")
    names = (path.with_name(f"{path.stem}_recovered_{number}{path.suffix}") for number in count(1))
    whole = next(name for name in names if not name.exists() and not recording_of(name).exists())
    aside = recording_of(whole)
    try:
        os.rename(left, aside)
    except OSError as error:
        message = f"An earlier recording cannot be finished: {error.strerror or error}."
        raise OutputNotWritable(message, where=str(left)) from error
    return whole if finish(aside, whole) else None


def pack_head(form: str, version: int, **values: object) -> bytes:
    """Encode a recording's header as a line of JSON."""
    return json.dumps({"format": form, "version": version, **values}).encode() + b"\n"


def pack_row(*parts: Any) -> bytes:
    """Encode a row of numbers as little-endian float64."""
    return np.concatenate([np.ravel(part) for part in parts]).astype("<f8").tobytes()


def read_rows(
    recording: Path, form: str, version: int, width: Callable[[dict[str, Any]], int]
) -> tuple[dict[str, Any], np.ndarray]:
    """Read the header and the (N, width) rows of a recording. A truncated last row is skipped.

    Raises:
        FileDamaged: the recording has a different format, version or body.
    """
    head, line, content = recording.read_bytes().partition(b"\n")
    if not line:  # the run ended before the first item was complete
        return {}, np.zeros((0, 0))
    try:
        found = json.loads(head)
        if (found["format"], found["version"], found["body"]) == (form, version, load_body().id):
            size = width(found)
            count = len(content) // (8 * size)
            return found, np.frombuffer(content[: 8 * size * count], "<f8").reshape(count, size)
    except (ValueError, KeyError, TypeError, RecursionError, MocapError):
        pass
    raise FileDamaged("The recording cannot be read, or belongs to another body.", where=str(recording), hint=_AGAIN)


PointRecorder = Recorder[[PointFrame]]
PoseRecorder = Recorder[[float, np.ndarray, np.ndarray]]
FaceRecorder = Recorder[[float, dict[str, float]]]
_FRAMES_AT_ONCE = 512  # Maximum number of frames in memory while a recording of points is completed.
_POSES, _VERSION, _ROW = "manifold_mocap_live_poses", 1, 4 + 3 * SMPL_HANDS.num_joints
_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 144.0, 200.0, 240.0)
"""Frame rates that senders commonly use."""
_NEAR = 0.03  # Largest relative difference between a measured and a common rate.
_NEIGHBOURS = 4.0  # Intervals longer than this many usual intervals are pauses, not lost frames. Chosen by hand.
_LEAST_STEP_S = 1e-4  # Smallest time between two poses in seconds. Chosen by hand.
_SILENCE_S, _CUT_TO_S = 10.0, 1.0  # Silences (s) longer than the first value are shortened to the second.
_GAP_S = 0.1  # Frames further than this (seconds) from a received pose are marked as interpolated.


@dataclass(frozen=True)
class PointsRecording(RecordingFormat[[PointFrame]]):
    """Recording of live points. Marker readers can also open the unfinished file (see ``live_recording``)."""

    pieces: ClassVar[str] = "frames"
    fps: float | None = None  # Nominal rate, or None if there is none.
    world: Callable[[], np.ndarray | None] = lambda: None
    """Function that returns the (3, 3) matrix from the points to metres with Z up, or None while it is unknown."""

    def encode(self, frame: PointFrame) -> bytes:
        """Encode the points of one frame."""
        return pack_block(LiveBlock(frame.time, frame.points, self.fps, self.world()))

    def finish(self, recording: Path, path: Path, *, overwrite: bool = False, lost: int = 0) -> bool:
        """Write a C3D file. Points are not transformed if their unit and up axis were never determined."""
        with recording.open("rb") as stream:
            extent = measure_recording(stream)
            world = self.world()
            turn = extent.to_metres if world is None else world
            turn = np.eye(3) if turn is None else np.asarray(turn)
            # Rows of a scaled rotation: no coordinate can grow by more than the sum over a row.
            reach = extent.largest * float(np.abs(turn).sum(axis=1).max())
            size = C3dSize(extent.frames, unnamed_labels(extent.most), extent.rate, reach)
            stream.seek(0)
            parts = ((part @ turn.T, None) for part in read_parts(stream, extent.most, _FRAMES_AT_ONCE))
            if extent.most:
                try:
                    write_c3d_parts(path, size, parts, overwrite=overwrite)
                except OutputNotWritable as error:
                    kept = f"{extent.frames} of {extent.frames + lost} frames are in {recording.name}"
                    hint = f"{kept}. `info` and `solve` can read this file, and the next run completes it."
                    raise OutputNotWritable(error.message, where=str(path), hint=hint) from error
        recording.unlink()
        return bool(extent.most)


def record_points(frames: Iterable[PointFrame], recorder: PointRecorder) -> Iterator[PointFrame]:
    """Record the frames of a stream, and yield them unchanged. Frames with a fault are not recorded."""
    for frame in frames:
        if not frame.fault:
            recorder.add(frame)
        yield frame


@dataclass
class PosesRecording(RecordingFormat[[float, np.ndarray, np.ndarray]]):
    """Recording of the live poses of one sender."""

    pieces: ClassVar[str] = "poses"
    source: str = ""
    person: Callable[[], tuple[Body, np.ndarray]] = lambda: (load_body(), np.zeros(10))
    """Function that returns the body and its (10,) shape. It is called at the first pose."""
    _last: float | None = field(default=None, init=False)
    _cut: float = field(default=0.0, init=False)

    def head(self) -> bytes:
        """Return the header line with the body and its shape."""
        body, betas = self.person()
        return pack_head(_POSES, _VERSION, body=body.id, betas=np.asarray(betas).tolist(), source=self.source)

    def encode(self, time: float, rotvec: np.ndarray, transl: np.ndarray) -> bytes:
        """Encode a pose as a row: seconds, translation (3,) in metres, and (24, 3) or (52, 3) rotation vectors."""
        if self._last is not None and abs(time - self._last) > _SILENCE_S:  # a silence, or a clock that was reset
            self._cut += time - self._last - _CUT_TO_S
        self._last = time
        turns = np.zeros((SMPL_HANDS.num_joints, 3))
        known = len(rotvec) if len(rotvec) == len(turns) else FIRST_FINGER
        turns[:known] = rotvec[:known]
        return pack_row([time - self._cut], transl, turns)

    def finish(self, recording: Path, path: Path, *, overwrite: bool = False, lost: int = 0) -> bool:
        """Write a motion file with a constant frame rate (see ``RecordingFormat``)."""
        head, rows = read_rows(recording, _POSES, _VERSION, lambda _: _ROW)
        if len(rows):
            with np.errstate(invalid="ignore"):  # a damaged row can contain any bytes
                rows = rows[(np.abs(rows[:, 1:4]) < FARTHEST_M).all(1) & (np.abs(rows[:, 4:]) < LARGEST_TURN).all(1)]
            body = load_body()
            if rows[:, 4 + 3 * FIRST_FINGER :].any():
                body = with_fingers(body)
            else:
                rows = np.pad(rows[:, : 4 + 3 * FIRST_FINGER], ((0, 0), (0, 3 * (SMPL.num_joints - FIRST_FINGER))))
            rows = ascending_rows(rows, recording)
            try:
                betas, source = np.array(head["betas"], np.float64).reshape(10), str(head["source"])
            except (KeyError, TypeError, ValueError) as error:
                raise FileDamaged("The recording contains no body shape.", where=str(recording), hint=_AGAIN) from error
            fps, times = even_times(rows[:, 0])
            motion = poses_at(times, rows, fps, betas, body, source)
            write_motion(path, motion, overwrite=overwrite)
        recording.unlink()
        return len(rows) > 0


def ascending_rows(rows: np.ndarray, recording: Path) -> np.ndarray:
    """Select the rows with increasing times in seconds, which are in the first column.

    If a clock was set back, rows are omitted until it catches up.

    Raises:
        FileDamaged: there are no rows, or they span more time than a recording can.
    """
    rows = rows[np.isfinite(rows[:, 0])]
    latest = np.maximum.accumulate(rows[:, 0])
    rows = rows[np.concatenate([[True], rows[1:, 0] > latest[:-1] + _LEAST_STEP_S])[: len(rows)]]
    if not len(rows) or rows[-1, 0] - rows[0, 0] > LONGEST_S:
        raise FileDamaged(
            "The recording's times are damaged.",
            where=str(recording),
            hint="Move or rename the file, and record again.",
        )
    return rows


def poses_at(times: np.ndarray, rows: np.ndarray, fps: float, betas: np.ndarray, body: Body, source: str) -> Motion:
    """Interpolate recorded poses to a motion at (F,) regular times. Rotations are interpolated by SLERP.

    Each of the (N, 4 + 3 J) rows contains the time in seconds, the translation and the rotation vectors of a pose.
    """
    after = np.clip(np.searchsorted(rows[:, 0], times), 1, max(len(rows) - 1, 1))
    before, after = after - 1, np.minimum(after, len(rows) - 1)
    apart = rows[after, 0] - rows[before, 0]
    share = np.clip((times - rows[before, 0]) / np.where(apart > 0, apart, 1.0), 0.0, 1.0)
    quat = sign_continuous(quat_from_rotvec(rows[:, 4:].reshape(len(rows), -1, 3)))
    between = np.broadcast_to(share[:, None], (len(times), quat.shape[1]))
    rotvec = rotvec_from_quat(slerp(quat[before], quat[after], between))
    transl = rows[before, 1:4] + share[:, None] * (rows[after, 1:4] - rows[before, 1:4])
    nearest = np.minimum(np.abs(times - rows[before, 0]), np.abs(rows[after, 0] - times))
    joints = forward_kinematics(body, betas, exp_so3(rotvec[:, 0]), exp_so3(rotvec[:, 1:]), transl).joints
    vectors = {"global_orient": rotvec[:, 0], "body_pose": rotvec[:, 1:].reshape(len(times), -1), "transl": transl}
    states = {"contacts": standing_feet(body, betas, joints, fps)}
    states["flags"] = np.where(nearest > _GAP_S, FLAG_UNSEEN, 0).astype(np.uint8)
    known = {"body": body.id, "body_layout": body.layout, "provenance": {"source": source, "method": "live poses"}}
    return Motion(betas=betas, fps=fps, joints=joints, **vectors, **states, **known)


def even_times(times: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the frame rate of (N,) recorded times in seconds, and (F,) regular times over the same range."""
    fps = rate_of(times)
    return fps, times[0] + np.arange(round((times[-1] - times[0]) * fps) + 1) / fps


def rate_of(times: np.ndarray) -> float:
    """Estimate the frame rate of (F,) times with jitter and gaps. Return a common rate or the nearest whole number."""
    if len(times) < 2:
        return 60.0
    apart = np.diff(times)
    usual_s = float(np.median(apart))
    near = apart[apart < _NEIGHBOURS * usual_s]
    rate = float(np.rint(near / usual_s).sum() / near.sum())
    usual = min(_RATES, key=lambda known: abs(math.log(known / rate)))
    return usual if abs(usual / rate - 1.0) < _NEAR else float(max(round(rate), 1))


@dataclass(frozen=True)
class FaceRecording(RecordingFormat[[float, dict[str, float]]]):
    """Recording of the channels of a live face.

    The table has a ``time`` column in seconds and one column per channel. Missing channels keep their last values.
    """

    pieces: ClassVar[str] = "frames"

    def encode(self, time: float, channels: dict[str, float]) -> bytes:
        """Encode a frame as a JSON line with its time in seconds and the value of each channel."""
        return json.dumps([round(time, 6), channels]).encode() + b"\n"

    def finish(self, recording: Path, path: Path, *, overwrite: bool = False, lost: int = 0) -> bool:
        """Write the table of channels (see ``RecordingFormat``)."""
        frames: list[tuple[float, dict[str, float]]] = []
        try:
            for line in recording.read_bytes().splitlines(keepends=True):
                if line.endswith(b"\n"):  # the last line may be truncated
                    seconds, channels = json.loads(line)
                    frames.append((float(seconds), {str(name): float(value) for name, value in channels.items()}))
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise FileDamaged("The face recording cannot be read.", where=str(recording), hint=_AGAIN) from error
        if frames:
            names = list(dict.fromkeys(name for _, channels in frames for name in channels))
            table, last = io.StringIO(newline=""), dict.fromkeys(names, 0.0)
            writer = csv.writer(table, lineterminator="\n")
            writer.writerow(["time", *names])
            for seconds, channels in frames:
                last |= channels
                writer.writerow([f"{seconds:.6f}", *(f"{last[name]:.4f}" for name in names)])
            write_text(path, table.getvalue(), overwrite=overwrite)
        recording.unlink()
        return bool(frames)
