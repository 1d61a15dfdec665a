"""Run the solver's live process, and read its newest pose without blocking."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .._exchange.body_layout import SMPL, SMPL_HANDS
from .._exchange.errors import ErrorEvent, sentence
from .._exchange.plain_text import plain
from ..backend_environment import backend_command, environment_for_child
from ..errors import SolverDied
from .child import SolverProcess

NUM_BETAS = 10
_MOST_LINES = 100_000
"""Largest number of lines read per poll. Only the last pose among them is used. Chosen by hand."""
_LOG_LINES = 200
SENSORS_GRACE_S = 20.0
"""Seconds that sensors get to end. Their processes need up to 5 s, and recordings are written before that."""


@dataclass(frozen=True)
class LivePose:
    """The body and points at one time, in metres with Z up."""

    rotvec: np.ndarray | None
    """(24, 3) axis-angle vectors, root first, or (52, 3) if the source has fingers, or None without a pose."""
    transl: np.ndarray | None  # (3,) metres.
    points: np.ndarray  # (N, 3) metres, as they were recorded.
    state: str  # ``tracking``, ``unsure``, ``waiting``, ``no_person`` or ``frozen``.
    why: str  # Why a pose is missing or unsure.
    off_mm: float  # Median distance of the markers from the body, or NaN without a pose.
    coverage: dict[str, float] = field(default_factory=dict)
    """Fraction of each sensor's image that the wand has covered, by sensor name."""
    rate_hz: float = math.nan  # Poses per second, measured over the last second.
    latency_ms: float = math.nan  # Time that the fit took.
    lag_ms: float = math.nan  # Delay between the source and the pose.
    dropped: int = 0  # Number of frames that were skipped to limit the delay.
    face: dict[str, float] = field(default_factory=dict)
    """Values of the face channels, keyed by the names that the sender uses."""
    off_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(N,) distance of each point from the body in metres, NaN for points on other objects, or (0,) if unknown."""
    sigma_m: np.ndarray | None = None  # (24,) standard deviation of each joint in metres, or None if unknown.
    views: int = 0  # Number of cameras that contribute to the pose.
    views_left_out: int = 0  # Number of views that arrived too late to be used.


@dataclass
class LiveRun:
    """A live run and its state, which ``poll`` updates. Invalid lines from the process do not raise errors."""

    process: SolverProcess
    shown: int = 0  # Number of poses that were shown.
    dropped: int = 0  # Number of poses that were skipped because newer ones had arrived.
    betas: np.ndarray | None = None  # (10,) shape, once known.
    latest: LivePose | None = None
    message: str = ""  # Last message from the solver.
    result: Any = None
    error: ErrorEvent | None = None
    finished: bool = False
    log: deque[str] = field(default_factory=lambda: deque(maxlen=_LOG_LINES))

    def poll(self) -> LivePose | None:
        """Read new lines. Return the newest pose since the last call, or None."""
        code = self.process.exit_code  # read first, so that everything written before the end is already in the queue
        newest: str | None = None
        for item in self.process.received(_MOST_LINES):
            if isinstance(item, dict):
                self._event(item)
            elif item.startswith("{"):
                self.dropped += newest is not None
                newest = item
            elif item.strip():
                self.log.append(plain(item, keep="\t"))
        if code is not None and newest is None and not self.finished:
            self.finished = True
            stopped_first = self.process.cancelling and self.latest is None  # nothing was recorded that could be lost
            if self.result is None and self.error is None and not stopped_first:
                message = f"The live solver ended without a message (exit code {code})."
                self.error = SolverDied(message, hint="Its last messages are in the log.").as_event()
        pose = None if newest is None else read_pose_line(newest)
        if pose is not None:
            self.shown, self.latest = self.shown + 1, pose
        return pose

    def stop(self) -> None:
        """Ask the process to end. It first writes its recordings."""
        self.process.cancel()

    @property
    def recorded(self) -> Path | None:
        """The recorded take, or None until it has been written."""
        path = (self.result or {}).get("recorded")
        return Path(path) if isinstance(path, str) and path else None

    @property
    def failure(self) -> str:
        """Error of the live run as a sentence, or "" without an error."""
        if self.error is None or self.error["code"] == "cancelled":  # it was asked to end before it had begun
            return ""
        return sentence(self.error)

    def _event(self, event: Any) -> None:
        kind, message = event.get("event"), event.get("message")
        if kind == "result":
            self.result = event
        elif kind == "error" and all(isinstance(event.get(key), str) for key in ("code", "message", "where", "hint")):
            self.error = event
        elif kind == "shape":
            betas = _numbers(event.get("betas"), NUM_BETAS)
            self.betas = self.betas if betas is None else betas
        if kind not in ("result", "progress") and isinstance(message, str):
            self.message = plain(message)
            self.log.append(self.message)


def read_pose_line(line: str) -> LivePose | None:
    """Return the pose in a line of ``live stream``, or None if the line contains none."""
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(values, dict) or not isinstance(values.get("state"), str):
        return None
    cloud = _numbers(values.get("cloud") or [], None)
    if cloud is None:
        return None
    off, points = _numbers(values.get("off_mm"), 1), cloud.reshape(-1, 3)
    rotvec = transl = None
    if "pose" in values:
        root, pose = _numbers(values.get("root"), 3), _numbers(values["pose"], None)
        transl = _numbers(values.get("trans"), 3)
        if root is None or pose is None or len(pose) < 3 * SMPL.num_solved or transl is None:
            return None
        layout = SMPL_HANDS if len(pose) >= 3 * SMPL_HANDS.num_solved else SMPL
        rotvec = np.zeros((layout.num_joints, 3))
        rotvec[0], rotvec[1 : 1 + layout.num_solved] = root, pose.reshape(-1, 3)[: layout.num_solved]
    rates: dict[str, Any] = {key: _number(values.get(key)) for key in ("rate_hz", "latency_ms", "lag_ms")}
    counts: dict[str, Any] = {key: _count(values.get(key)) for key in ("dropped", "views", "views_left_out")}
    sigma_m, off_mm = _metres(values.get("sigma_mm"), SMPL.num_joints), math.nan if off is None else float(off[0])
    return LivePose(
        rotvec=rotvec,
        transl=transl,
        points=points,
        state=plain(values["state"]),
        why=plain(str(values.get("why", ""))),
        off_mm=off_mm,
        coverage=_by_name(values.get("coverage"), 0.0, 1.0),
        face=_by_name(values.get("face")),
        off_m=_metres(values.get("cloud_off_mm"), len(points)),
        sigma_m=sigma_m if len(sigma_m) else None,
        **rates,
        **counts,
    )


def _count(value: Any) -> int:
    found = _number(value)
    return 0 if math.isnan(found) else max(int(found), 0)


def _metres(values: Any, count: int) -> np.ndarray:
    """Convert ``count`` values from millimetres to metres. Invalid values become NaN."""
    if not isinstance(values, list) or len(values) != count:
        return np.zeros(0)
    return np.array([1e-3 * max(_number(value), 0.0) for value in values])


def _number(value: Any) -> float:
    found = _numbers(value, 1)
    return math.nan if found is None else float(found[0])


def _by_name(values: Any, low: float = -math.inf, high: float = math.inf) -> dict[str, float]:
    pairs = values.items() if isinstance(values, dict) else ()
    found = {plain(str(name)): _number(value) for name, value in pairs}
    return {name: value for name, value in found.items() if low <= value <= high}


def _numbers(values: Any, count: int | None) -> np.ndarray | None:
    """Return a flat array of ``count`` finite numbers, or None if the values are anything else."""
    try:
        array = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        return None
    fits = array.size % 3 == 0 if count is None else array.size == count
    return array if fits and np.isfinite(array).all() and (np.abs(array) < 1e6).all() else None


def start_live(
    verb: str, words: Sequence[str], python: Path | None, folder: Path, *, grace_s: float | None = None
) -> LiveRun:
    """Start a live verb of the solver in a working folder (see ``SolverProcess``)."""
    command = [*backend_command(python), verb, *words, "--with-points", "--json", "--parent-pipe"]
    return LiveRun(SolverProcess(command, environment_for_child(python), folder, grace_s))
