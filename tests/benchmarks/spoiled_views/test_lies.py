"""Test on the command line that wrong recordings are solved, and that JSON and report state the cause."""

from __future__ import annotations

import html
import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.diagnostics import read_diagnostics, sentence
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.benchmarks.spoiled_views.kinds import KINDS, Recording
from tests.benchmarks.spoiled_views.lie_rows import ROWS, found_of
from tests.benchmarks.spoiled_views.lies import LIES
from tests.benchmarks.spoiled_views.more_lies import MORE_LIES
from tests.benchmarks.spoiled_views.trial import error_mm
from tests.support.trial_files import write_trial

pytestmark = pytest.mark.slow

FRAMES = 120
LIMIT_MM = 10.0
"""Limit of the error. Without faults, these frames have 8.4 mm."""
NAMED = {
    "cameras exchanged": "camera_names_exchanged", "sides exchanged": "detections_corrected",
    "v from below": "detections_corrected", "one late": "camera_late", "half size": "calibration_corrected",
    "cm": "unit_by_person", "one mirrored": "image_mirrored", "confidence 0.01": "confidence_rescaled",
}  # fmt: skip
"""Fault, and the code of its diagnostic."""


def solved(kind: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict]:
    """Solve the changed recording of the demo without options, and return exit code and last event."""
    cameras, keypoints = demo_capture(FRAMES, 60.0).require_multiview()
    whole = Recording(keypoints.xy, keypoints.confidence, cameras, cameras.names)
    spoiled = (KINDS | LIES | MORE_LIES)[kind](whole, np.random.default_rng(0), 0)
    write_trial(
        folder / "trial", cameras=spoiled.cameras, people=[(spoiled.xy, spoiled.confidence)], names=spoiled.names,
        calibrated=spoiled.cameras.names, config="[project]\nframe_rate = 60\n",
    )  # fmt: skip
    out = ["--out", str(folder / "motion.npz"), "--report", str(folder / "report.html"), "--json"]
    code = main(["solve", str(folder / "trial"), *out])
    return code, json.loads(capsys.readouterr().out.splitlines()[-1])


@pytest.mark.parametrize("kind", NAMED)
def test_what_can_be_corrected_is_named_everywhere(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, event = solved(kind, tmp_path, capsys)
    assert code == 0
    (named,) = [item for item in read_diagnostics(event["diagnostics"]) if item.code == NAMED[kind]]
    assert named.severity == "warning"
    assert sentence(named)[:20] in html.unescape((tmp_path / "report.html").read_text("utf-8"))
    joints = np.asarray(demo_capture(FRAMES, 60.0).truth["joints"])
    assert error_mm(read_motion(tmp_path / "motion.npz").joints, joints) < LIMIT_MM


def test_keypoints_of_another_layout_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, event = solved("other layout", tmp_path, capsys)
    assert code == 3 and event["code"] == "result_refused" and "agree with the solved body" in event["message"]
    assert not (tmp_path / "motion.npz").exists()


@pytest.mark.parametrize(
    ("row", "code"),
    [("pictures dropped", "rate_differs"), ("person away", "person_away"), ("scaled by 1.25", "stature_odd")],
)
def test_what_cannot_be_corrected_is_named_everywhere_too(row: str, code: str, tmp_path: Path) -> None:
    found = found_of(ROWS[row], tmp_path)
    assert code in found.named and not found.missing and not found.refused


def test_lenses_that_two_seconds_cannot_check_change_the_stated_stature(tmp_path: Path) -> None:
    """120 frames show the error by 2.4 standard deviations, and longer takes show it (``test_focal_lengths``)."""
    found = found_of(ROWS["lenses 10 % long"], tmp_path)
    assert not found.refused and found.size_stated
