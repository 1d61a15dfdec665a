"""The embedded take of markers: what is committed is what the command makes, and it solves to the body that wore it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.io.load import load_capture
from solver_backend.io.markers.read import read_markers
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.embedded.demo import DEMO_TAKE, record_markers


def test_the_committed_file_is_the_seeded_take_and_small() -> None:
    recorded, stored = record_markers().cloud, read_markers(DEMO_TAKE).cloud
    assert DEMO_TAKE.stat().st_size < 200_000
    assert stored.labels == recorded.labels and stored.fps == recorded.fps
    assert (np.isfinite(stored.positions) == np.isfinite(recorded.positions)).all()
    assert np.nanmax(np.abs(stored.positions - recorded.positions)) < 1e-5
    assert np.nanmax(np.abs(record_markers(seed=1).cloud.positions - recorded.positions)) > 5e-3


def test_the_verb_reads_it_and_says_what_is_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dataset demo", "--markers", "--out", str(tmp_path / "capture.npz"), "--json"]) == 0
    names = json.loads(capsys.readouterr().out.splitlines()[-1])["marker_names"]
    assert len(names["known"]) == 41 and names["unknown"] == ["Demo:ARMBAND"] and names["subjects"] == ["Demo"]
    assert sum(gap["gaps"] for gap in names["gaps"]) > 10


def test_the_verb_writes_the_truth(tmp_path: Path) -> None:
    assert main(["dataset demo", "--markers", "--out", str(tmp_path / "capture.npz")]) == 0
    capture = load_capture(tmp_path / "capture.npz")
    assert capture.markers is not None
    off = np.linalg.norm(capture.markers.positions - capture.truth["markers"], axis=-1)
    assert np.nanmedian(off) < 0.01
    assert capture.truth["joints"].shape == (capture.num_frames, 24, 3)
    assert {"betas", "global_orient", "body_pose", "transl"} <= set(capture.truth)


@pytest.mark.slow
def test_it_solves_to_the_body_that_wore_it(tmp_path: Path) -> None:
    assert main(["solve", str(DEMO_TAKE), "--out", str(tmp_path / "motion.npz")]) == 0
    truth, motion = record_markers(), read_motion(tmp_path / "motion.npz")
    assert motion.joints is not None
    error_mm = 1000 * np.linalg.norm(motion.joints - truth.joints, axis=-1)
    assert error_mm.mean() < 10 and np.quantile(error_mm, 0.95) < 25
