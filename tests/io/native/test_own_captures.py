"""Our own capture files are looked at as those of other programs: what they say of their world is not believed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic, sentence
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.units_and_axes import with_up_axis
from solver_backend.synthesis.embedded.demo import demo_capture, record_markers
from solver_backend.types import Cameras, Capture
from tests.support.words import codes, words


@pytest.fixture(scope="module")
def demo() -> Capture:
    return replace(demo_capture(60), truth={})


def moved(cameras: Cameras, z: float) -> Cameras:
    """Return the cameras in a world whose floor lies at a height."""
    return replace(cameras, t=cameras.t - z * cameras.R[:, :, 2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda cameras: with_up_axis(cameras, "-z"), "stands along -Z"),
        (lambda cameras: with_up_axis(cameras, "y"), "stands along -?Y"),
        (lambda cameras: moved(cameras, 1.9), r"lowest foot is at z = 1\.[89]"),
        (lambda cameras: replace(cameras, t=0.3 * cameras.t), r"would be 0\.5\d* m tall"),
        (lambda cameras: replace(cameras, t=1000.0 * cameras.t), "Check the unit of the calibration"),
    ],
)
def test_a_world_that_cannot_be_is_named(demo: Capture, tmp_path: Path, change: object, told: str) -> None:
    cameras = change(demo.cameras)  # type: ignore[operator]
    known = diagnostic("person_triangulated", stature=1.77, lowest=0.0, size=2.0)
    stored = replace(demo, cameras=cameras, notes=(known,))
    capture = load_capture(write_capture(tmp_path / "a.npz", stored))
    [problem] = [problem for problem in capture.problems if re.search(told, sentence(problem))]
    figures = [note for note in capture.notes if note.code == "person_triangulated"]
    assert problem and len(figures) == ("unit" not in told)
    again = load_capture(write_capture(tmp_path / "b.npz", capture))
    assert again.problems == capture.problems and again.notes == capture.notes


def test_a_sound_capture_has_no_problems(demo: Capture, tmp_path: Path) -> None:
    assert words(load_capture(write_capture(tmp_path / "a.npz", demo)).problems) == ()


@pytest.mark.parametrize(
    ("turn", "scale", "expected"),
    [
        (
            np.diag([1.0, -1.0, -1.0]),
            1.0,
            {"up_axis_doubted": "stands along -Z, but in a capture file"},
        ),
        (np.eye(3)[[1, 2, 0]], 1.0, {"up_axis_doubted": "stands along Y, but in a capture file Z must point up"}),
        (np.eye(3), 100.0, {"marker_spread_unlikely": "but would if lengths were in cm"}),
        (np.eye(3), 0.01, {"marker_spread_unlikely": "The markers span"}),
        (np.eye(3), 1.0, {}),
    ],
)
def test_markers_of_another_size_or_world_are_named(
    tmp_path: Path, turn: np.ndarray, scale: float, expected: dict[str, str]
) -> None:
    cloud = record_markers(60).cloud
    changed = Capture("m", markers=replace(cloud, positions=scale * cloud.positions @ turn.T))
    once = load_capture(write_capture(tmp_path / "m.npz", changed))
    assert codes(once.problems) == tuple(expected)
    assert all(text in sentence for text, sentence in zip(expected.values(), words(once.problems), strict=True))
    again = load_capture(write_capture(tmp_path / "again.npz", once))
    assert again.problems == once.problems, "and once"
