"""Capture files that are odd or forged: each is read with a problem or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Capture, JointSet, PersonInViews
from tests.fuzz.odd_motions import changed
from tests.fuzz.target import Write
from tests.support.scenes import detected, small_capture, small_markers, walker


def _capture(**told: Callable[[Any], Any]) -> Write:
    """Return what writes a capture whose cameras are changed, or whose keypoints are."""

    def write(folder: Path) -> None:
        base = small_capture(2, views=2)
        points = walker(JointSet.COCO_17, 2, (0.0, 0.0), (0.1, 0.0))
        xy, confidence = detected(base.cameras, points, np.random.default_rng(0))
        keypoints = replace(base.keypoints, xy=xy, confidence=confidence)
        of_cameras = {key: value for key, value in told.items() if hasattr(base.cameras, key)}
        others = {key: value for key, value in told.items() if key not in of_cameras}
        keypoints = replace(keypoints, **{key: value(getattr(keypoints, key)) for key, value in others.items()})
        cameras = replace(base.cameras, **{key: value(getattr(base.cameras, key)) for key, value in of_cameras.items()})
        write_capture(folder / "a.npz", replace(base, cameras=cameras, keypoints=keypoints))

    return write


def _set(place: Any, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array = np.array(array, dtype=np.float64)
        array[place] = value
        return array

    return change


def _markers_as(**arrays: object) -> Write:
    """Return what writes a capture of markers and changes its arrays."""
    return changed(lambda folder: write_capture(folder / "a.npz", Capture("m", markers=small_markers())), **arrays)


def several(**arrays: object) -> Write:
    """Return what writes a capture of two people and changes its arrays."""
    plain = small_capture(2, views=2)
    keypoints = plain.keypoints
    assert keypoints is not None
    people = (PersonInViews("left", keypoints), PersonInViews("right", replace(keypoints, xy=keypoints.xy + 5.0)))
    capture = replace(plain, people=people, person="right")
    return changed(lambda folder: write_capture(folder / "a.npz", capture), **arrays)


_PLAIN = small_capture(2, views=2)
_FORGED: tuple[dict[str, Any], ...] = (
    {"K": -_PLAIN.cameras.K}, {"K": _PLAIN.cameras.K * np.nan}, {"K": _PLAIN.cameras.K[:1]}, {"K": None},
    {"image_size": [[0, 0], [0, 0]]}, {"image_size": [["a", "b"], ["c", "d"]]}, {"footage": ["a.mp4"]},
    {"distortion_model": "other"}, {"confidence": None}, {"confidence": np.zeros((2, 2, 3))}, {"xy": np.zeros((2, 2))},
    {"camera_names": ["a", "a"]}, {"camera_names": ["", ""]}, {"joint_set": "NONE"}, {"fps": 0.0}, {"fps": "fast"},
    {"camera_names": ["a"]}, {"xy": np.zeros((3, 2, 17, 2)), "confidence": np.ones((3, 2, 17))},
    {"footage": ["/elsewhere/a.mp4", "..\\b.mp4"]}, {"name": 3}, {"sources": 1},
    {"footage": ["x" * 5000, "~nobody/a.mp4"]},
)  # fmt: skip
CAPTURES: tuple[Write, ...] = (
    *(changed(lambda folder: write_capture(folder / "a.npz", _PLAIN), **forged) for forged in _FORGED),
    _markers_as(marker_labels=["C7", "C7", ""]),
    _markers_as(marker_labels=["C7"]),
    _markers_as(marker_labels="C7"),
    _markers_as(marker_labels=["C7", "a", "b", "c"]),
    _markers_as(marker_positions=np.zeros((0, 3, 3)), marker_residual=None),
    _markers_as(marker_positions=np.full((5, 3, 3), 7e37)),
    _markers_as(marker_fps=np.nan),
    _markers_as(marker_fps=1e300),
    _markers_as(markers=np.zeros((5, 3))),
    _markers_as(markers=np.full((5, 3, 3), np.inf)),
    _capture(),
    _capture(K=_set((0, 2, 0), 3.0)),
    _capture(K=_set((0, 0, 0), 3.0)),
    _capture(K=_set((0, 0, 0), 1e6)),
    _capture(K=_set((0, 0, 0), 300.0)),
    _capture(K=_set((0, 0, 2), -900.0)),
    _capture(distortion=_set((0, 0), -0.9)),
    _capture(t=_set((0, 2), 500.0)),
    _capture(t=_set((0, 2), 1e9)),
    _capture(t=lambda t: t[[0, 0]], R=lambda R: R[[0, 0]]),
    _capture(fps=lambda fps: 5000.0),
    _capture(fps=lambda fps: 1e6),
    _capture(confidence=lambda c: c * 100),
    _capture(confidence=lambda c: c * 3),
    _capture(confidence=lambda c: c * 0),
    _capture(confidence=_set((0,), 0.0)),
    _capture(xy=lambda xy: xy + 1e6),
    _capture(xy=lambda xy: xy + 5000),
    _capture(xy=lambda xy: xy[::-1]),
    _capture(xy=lambda xy: xy[:, :1], confidence=lambda c: c[:, :1]),
    _capture(confidence=lambda c: c * 1000),
    several(people_xy=np.zeros((2, 2))),
    several(person="nobody"),
)
