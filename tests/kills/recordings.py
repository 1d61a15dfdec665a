"""Operations on markers, footage and sensors, which begin from recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from solver_backend.io.markers.read import write_markers
from solver_backend.synthesis.embedded.demo import record_markers
from tests.kills.operation import Operation
from tests.support.pose_models import write_rtmpose
from tests.support.videos import write_dots

_SPEC = {
    "camera_arrays": [{"preset": "azure_kinect_3", "scale": 0.2}], "frames": 6, "fps": 10, "film": ["masks"],
    "write": ["pose2sim", "c3d"], "seed": 9,
}  # fmt: skip
_PICTURES = 90


def _take(folder: Path, solved: Path) -> None:
    write_markers(folder / "take.c3d", record_markers().cloud)


def _footage(folder: Path, solved: Path) -> None:
    write_rtmpose(folder / "model.onnx")
    (folder / "footage" / "videos").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name in ("cam01", "cam02"):
        dots = np.array([[30.0, 25.0], [120.0, 40.0], [80.0, 95.0]])
        path = dots + np.cumsum(rng.normal(0, 0.3, (_PICTURES, 3, 2)), axis=0)
        write_dots(folder / "footage" / "videos" / f"{name}.mp4", path, np.arange(_PICTURES) / 30.0)


def _spec(folder: Path, solved: Path) -> None:
    (folder / "spec.json").write_text(json.dumps(_SPEC))


def _nothing(folder: Path, solved: Path) -> None:
    """A recording begins from the cameras alone."""


_PROGRAM = ("-m", "solver_backend")
RECORDINGS = (
    Operation(
        "calibrate",
        _take,
        (*_PROGRAM, "markers calibrate", "take.c3d", "--out", "subject.npz"),
        frozenset({"subject.npz"}),
    ),
    Operation("label", _take, (*_PROGRAM, "markers label", "take.c3d", "--out", "out.c3d"), frozenset({"out.c3d"})),
    Operation(
        "live",
        _take,
        (*_PROGRAM, "live stream", "take.c3d", "--fast", "--record", "out.c3d"),
        frozenset({"out.c3d"}),
        r"out_recovered_\d+\.c3d",
    ),
    Operation(
        "from-videos",
        _footage,
        (*_PROGRAM, "from-videos", "footage", "--detector", "model.onnx", "--sync", "none", "--until", "sync"),
        frozenset({"footage/mocap/sync.json", "footage/mocap/steps.json"}),
    ),
    Operation(
        "studio",
        _spec,
        (*_PROGRAM, "dataset make", "spec.json", "--out", "set"),
        frozenset({"set/card.md", "set/contact_sheet.png"}),
    ),
    Operation(
        "sensors record",
        _nothing,
        (*_PROGRAM, "sensors record", "out", "--oak", "1=left", "--oak", "2=right", "--seconds", "1"),
        frozenset({"out/recording.json", "out/left/frames.bin", "out/right/frames.bin"}),
        begins_apart=True,
    ),
)
