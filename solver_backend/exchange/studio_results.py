"""What the studio's verbs report, and what a shot's ``shot.json`` states: read where shots are coloured and listed."""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict, TypeGuard


class ShotRecord(TypedDict):
    """A shot of a data set."""

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
    size: list[list[int]]
    """Width and height of each camera's pictures."""
    look: str
    clothes: str
    hair: str
    light: str
    markers: int
    film: list[str]
    visible: float
    inside: float
    """Shares of keypoints that are visible, and of the person that is within the pictures."""
    views: list[int]
    poses: dict[str, list[int]]
    rgb: dict[str, Any]
    """Settings of the colour pictures."""
    rgb_seed: int


def is_shot_record(value: object) -> TypeGuard[ShotRecord]:
    """Return whether the content of a file can be a record."""
    return isinstance(value, dict)


class DataSetPlan(TypedDict):
    """Of ``studio``."""

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


class BenchmarkRow(TypedDict):
    """How near a method comes to the truth of a shot."""

    shot: str
    camera_array: str
    faults: str
    input: str
    method: str
    mpjpe_mm: float | None
    pa_mpjpe_mm: float | None
    accel_m_s2: float | None
    seconds: float | None
    error: str


class BenchmarkResult(TypedDict):
    """Of ``studio-benchmark``."""

    page: str
    table: str
    places: NotRequired[str]
    rows: list[BenchmarkRow]
