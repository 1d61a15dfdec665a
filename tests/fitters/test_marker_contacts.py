"""Markers of a person who kneels: skin touches a floor only if the user states one, and a wrong one is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.types import Capture, MarkerCloud, MarkerSubject, Motion
from tests.support.floor_takes import kneeling

NAMES = """
LFHD RFHD LBHD RBHD C7 T10 CLAV STRN LSHO LELB LWRA LWRB LFIN RSHO RELB RWRA RWRB RFIN LASI RASI LPSI RPSI LTHI
LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE
"""
LABELS = tuple(NAMES.split())


def rising() -> Person:
    """Return a person who kneels for half a second and then stands up. The lowest skin is at z = 0."""
    bent, one = np.r_[np.ones(30), np.linspace(1.0, 0.0, 30), np.zeros(50)], kneeling(1, 0.0)
    local = exp_so3(bent[:, None, None] * log_so3(one.local[0]))
    person = replace(one, orient=np.tile(one.orient, (110, 1, 1)), local=local, transl=np.zeros((110, 3)))
    lowest = person.skin(np.arange(110))[..., 2].min(axis=1)
    return replace(person, transl=-lowest[:, None] * [0.0, 0.0, 1.0])


def solved(floor_m: float, fps: float, settings: SolveSettings) -> Motion:
    """Return the solve of a person of known shape who kneels, with this much of the skin below z = 0."""
    person, rng = rising(), np.random.default_rng(4)
    places = tuple(str(load_layouts().place_of(label)) for label in LABELS)
    points = person.pose(marker_landmarks(person.body, places)).points - [0.0, 0.0, floor_m]
    cloud = MarkerCloud(points + 0.001 * rng.normal(size=points.shape), fps, LABELS)
    still, count = np.zeros((len(LABELS), 3)), len(LABELS)
    thick = np.array([0.0, 0.6, *np.zeros(8)])
    known = MarkerSubject(person.body.id, thick, LABELS, places, still, np.full(count, 0.004), np.full(count, 0.01), {})
    return solve(Capture("kneels", markers=cloud), settings, person=known).motion


def codes(motion: Motion) -> set[str]:
    """Return the codes of a motion's diagnostics."""
    return {item["code"] for item in motion.provenance.get("diagnostics", ())}


def depth_mm(motion: Motion) -> float:
    """Return the mean depth of the deepest skin below z = 0."""
    turns = exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3)[:, :21].astype(float))
    root, body = exp_so3(motion.global_orient.astype(float)), rising().body
    skin = pose_mesh(body, motion.betas.astype(float), root, turns, motion.transl.astype(float))
    return -1000.0 * float(np.minimum(skin[..., 2].min(axis=1), 0.0).mean())


@pytest.fixture(name="stated")
def stated_floor(tmp_path: Path) -> SolveSettings:
    """Return settings that state the floor."""
    file = tmp_path / "objects.json"
    file.write_text("{}")
    return SolveSettings(objects=str(file))


@pytest.mark.slow
def test_skin_stays_above_a_stated_floor_at_any_rate(stated: SolveSettings) -> None:
    bare, found = (solved(0.006, 120.0, settings) for settings in (SolveSettings(), stated))
    assert bare.touches is None and found.touches is not None
    assert found.touches[:30, 2:4].mean() > 0.8 and not found.touches[60:, 2:4].any()
    assert depth_mm(found) < 0.5 * depth_mm(bare)
    assert np.linalg.norm(found.joints - bare.joints, axis=-1).mean() < 0.005


@pytest.mark.slow
def test_markers_refuse_a_floor_that_is_too_high(stated: SolveSettings) -> None:
    bare, found = (solved(0.025, 60.0, settings) for settings in (SolveSettings(), stated))
    assert "surface_contradicted" in codes(found) and not codes(bare)
    np.testing.assert_array_equal(found.joints, bare.joints)
