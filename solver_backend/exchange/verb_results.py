"""Define the result events of verbs that other programs depend on."""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict, TypeGuard

from .diagnostics import DiagnosticValues
from .errors import ErrorEvent


class PersonSummary(TypedDict):
    """A person in a capture with several people."""

    name: str
    frames: int
    first: int | None
    last: int | None
    views: float
    seen_percent: list[float]  # For each view, the percentage of frames in which the person is visible.


class Remarks(TypedDict):
    """Diagnostics of a result, both as data and as sentences."""

    notes: list[str]
    problems: list[str]
    diagnostics: list[DiagnosticValues]


class CaptureSummary(Remarks):
    """Contents of a capture."""

    name: str
    frames: int
    fps: float
    duration_s: float | None
    cameras: list[dict[str, Any]]
    joint_set: str | None
    markers: int | None
    people: list[PersonSummary]
    person: str
    truth: list[str]
    own_points: NotRequired[dict[str, str]]  # Bone of each user-defined keypoint.
    bridged_frames: NotRequired[list[list[int]]]
    marker_names: NotRequired[dict[str, Any]]


class CaptureResult(CaptureSummary):
    """Result of ``convert``, which writes a capture file."""

    capture: str
    source: NotRequired[str]  # Trial in a session.


class RefineResult(CaptureResult):
    """Result of ``cameras refine``."""

    refined: list[dict[str, Any]]


class CheckResult(TypedDict):
    """Result of ``cameras check``."""

    verdict: str
    stature_m: float
    tilt_deg: float
    tilt_sigma_deg: float
    findings: list[str]
    diagnostics: NotRequired[list[DiagnosticValues]]


class MotionSummary(TypedDict):
    """Length of a solved motion, its residuals, and the number of frames to check."""

    frames: int
    fps: float
    duration_s: float
    solve_s: float
    reprojection_median_px: float | None
    marker_median_mm: float | None
    unseen_frames: int
    unsure_frames: int
    props: NotRequired[list[str]]


class SolveResult(MotionSummary):
    """Result of ``solve`` for one motion."""

    motion: str
    report: str | None
    diagnostics: list[DiagnosticValues]
    person: NotRequired[str]


class TakeResult(SolveResult):
    """Result of ``solve`` for one of several motions."""

    capture: str
    name: str


class TakesResult(TypedDict):
    """Result of ``solve`` for several captures or people."""

    takes: list[TakeResult]
    failed: list[dict[str, Any]]


class PersonResult(TypedDict):
    """Result of ``markers calibrate``."""

    body: str
    betas: list[float]
    markers: dict[str, dict[str, Any]]
    diagnostics: list[DiagnosticValues]
    subject: str
    problems: list[str]


class MarkersResult(TypedDict):
    """Result of ``markers export``."""

    markers_file: str
    frames: int
    fps: float
    markers: int
    contents: str


class ClipResult(Remarks):
    """Result of ``motion convert``: a converted clip from another program."""

    motion: str
    frames: int
    fps: float
    distance_mm: NotRequired[float]  # RMS distance between the limbs and the clip's limbs.


class GlovesResult(Remarks):
    """Result of ``hands add``."""

    motion: str
    frames: int
    fps: float
    gloves: list[dict[str, Any]]


class TakeOfVideos(TypedDict):
    """A take made from videos."""

    folder: str
    source: str
    read: CaptureResult | None  # None if its capture was not written.


class VideosResult(TypedDict):
    """Result of ``from-videos``: takes by name, and takes that failed."""

    plan: list[str]
    takes: dict[str, TakeOfVideos]
    failed: NotRequired[dict[str, ErrorEvent]]


class DetectorResult(TypedDict):
    """Result of installing a detector."""

    python: str
    models: list[str]


class OaksResult(TypedDict):
    """Result of ``sensors list``."""

    oaks: list[str]


class SensorsResult(TypedDict):
    """Result of a sensor calibration."""

    calibration: str
    findings: NotRequired[list[str]]
    notes: NotRequired[list[str]]


class ShotRecord(TypedDict):
    """A shot in a data set."""

    name: str
    frames: int
    fps: float
    seed: int
    motion: str
    motion_file: str
    person: int
    betas: list[float]
    body: str
    camera_array: str
    cameras: list[str]
    size: list[list[int]]  # Width and height of each camera's images.
    look: str
    clothes: str
    hair: str
    light: str
    markers: int
    film: list[str]
    visible: float
    inside: float  # Fractions of keypoints that are visible, and of the person that is inside the images.
    views: list[int]
    poses: dict[str, list[int]]
    rgb: dict[str, Any]  # Settings of the colour images.
    rgb_seed: int


def is_shot_record(value: object) -> TypeGuard[ShotRecord]:
    """Return whether a value read from a file can be a shot record."""
    return isinstance(value, dict)


class DataSetPlan(TypedDict):
    """Result of ``dataset make``."""

    shots: list[str]
    frames: int
    pictures: int
    needed_mb: float
    free_mb: float
    film: list[str]
    engine: str
    write: list[str]
    data_set: str
    card: NotRequired[list[str]]


class BenchmarkResult(TypedDict):
    """Result of ``dataset benchmark``."""

    page: str
    table: str
    places: NotRequired[str]
    rows: list[dict[str, Any]]
