"""The unit of a calibration is the one that makes the person possible; what no unit explains stays, and is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.load import load_capture
from solver_backend.io.recognition.person_scale import in_persons_unit
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Detections
from tests.support.trial_files import write_trial
from tests.support.words import words

DEMO = demo_capture(num_frames=90)
CAMERAS, KEYPOINTS = DEMO.require_multiview()
UNITS = {"cm": 100.0, "inch": 1 / 0.0254, "mm": 1000.0, "m": 1.0}


def unit_of(units_per_metre: float, guessed: str, xy: np.ndarray = KEYPOINTS.xy) -> tuple[Calibration, float]:
    """Return what is found of the demo, read as ``guessed`` where its file is in other units, '' for a known one."""
    metres = {"m": 1.0, "mm": 0.001, "": 1.0}[guessed]
    seen = Detections(CAMERAS.names, xy[:, :, None], KEYPOINTS.confidence[:, :, None], KEYPOINTS.joint_set)
    cameras = replace(CAMERAS, t=CAMERAS.t * units_per_metre * metres)
    return in_persons_unit(Calibration(cameras, Path(), guessed_unit=guessed), seen, keep=not guessed)


@pytest.mark.parametrize("guessed", ["m", "mm"])
@pytest.mark.parametrize("unit", UNITS)
def test_the_unit_is_that_of_the_person(unit: str, guessed: str) -> None:
    found, factor = unit_of(UNITS[unit], guessed)
    np.testing.assert_allclose(found.cameras.t, CAMERAS.t, rtol=1e-9)
    assert factor == 1.0
    read_as = [(item.code, item.values["unit"], item.values["guessed"]) for item in found.problems]
    assert read_as == [("unit_by_person", unit, guessed)] * (unit != guessed)
    assert all(1.6 < item.values["stature"] < 1.9 for item in found.problems)
    assert all(f"interpreted as {unit}" in problem for problem in words(found.problems))


def test_lengths_of_no_known_unit_stay_and_people_are_found_by_a_factor() -> None:
    found, factor = unit_of(3.3, "m")
    np.testing.assert_allclose(found.cameras.t, 3.3 * CAMERAS.t)
    assert factor == pytest.approx(1 / 3.3, rel=0.1) and not found.problems


@pytest.mark.parametrize(("scale", "guessed"), [(0.5, "m"), (1.5, "m"), (100.0, "")])
def test_children_giants_and_stated_units_stay(scale: float, guessed: str) -> None:
    found, _ = unit_of(scale, guessed)
    np.testing.assert_allclose(found.cameras.t, scale * CAMERAS.t)
    assert not found.problems


def test_views_that_agree_on_nobody_tell_no_unit() -> None:
    nonsense = np.random.default_rng(0).uniform(0, 1000, KEYPOINTS.xy.shape)
    found, factor = unit_of(100.0, "m", nonsense)
    assert (factor, found.problems) == (1.0, ())


@pytest.mark.slow
@pytest.mark.parametrize(("units_per_metre", "unit"), [(100.0, "cm"), (1 / 0.0254, "inch")])
def test_a_trial_in_other_units(tmp_path: Path, units_per_metre: float, unit: str) -> None:
    scaled = replace(CAMERAS, t=CAMERAS.t * units_per_metre)
    write_trial(tmp_path, cameras=scaled, people=[(KEYPOINTS.xy[:, :20], KEYPOINTS.confidence[:, :20])])
    capture = load_capture(tmp_path)
    np.testing.assert_allclose(capture.require_multiview()[0].t, CAMERAS.t, atol=1e-6)
    assert [item.values["unit"] for item in capture.problems if item.code == "unit_by_person"] == [unit]
    assert "unit_read" not in [item.code for item in capture.notes]
    kept = load_capture(tmp_path, unit=unit)
    assert "unit_by_person" not in [item.code for item in kept.problems]
    assert diagnostic("unit_read", source="given", unit=unit) in kept.notes
    np.testing.assert_allclose(kept.require_multiview()[0].t, CAMERAS.t, atol=1e-6)


@pytest.mark.slow
def test_a_trial_in_squares_of_a_board_is_found_and_scaled_by_a_stature(tmp_path: Path) -> None:
    scaled = replace(CAMERAS, t=CAMERAS.t * 14.7)
    write_trial(tmp_path, cameras=scaled, people=[(KEYPOINTS.xy[:, :20], KEYPOINTS.confidence[:, :20])])
    odd = load_capture(tmp_path)
    assert "stature_unlikely" in [item.code for item in odd.problems]
    assert "unit_read" in [item.code for item in odd.notes]
    known = load_capture(tmp_path, stature=1.75)
    np.testing.assert_allclose(known.require_multiview()[0].t, CAMERAS.t, rtol=0.05, atol=0.05)
