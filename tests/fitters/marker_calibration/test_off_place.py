"""Labels of the body on points of a chair: not believed, reported, and the rest of the person as without them."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.marker_names import name_markers
from solver_backend.body.markers import marker_layout
from solver_backend.exchange.diagnostics import Severity, refuse_errors, sentence
from solver_backend.exchange.errors import ResultRefused
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.marker_problem import off_place
from solver_backend.report.checks import recorded_diagnostics
from solver_backend.types import Capture, MarkerCloud
from tests.support.horse import NAMES, horse_markers
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")
CHAIR = ("LFRM", "RFRM")  # "front of the frame"; the layouts' forearms


@pytest.mark.slow
def test_names_that_point_elsewhere_are_not_used() -> None:
    take = worn_markers(LABELS, 24, fps=15.0, step=8)
    points = take.cloud.positions.copy()
    waist = points[:, [LABELS.index("LASI"), LABELS.index("RASI")]].mean(axis=1)
    for m, label in enumerate(LABELS):
        if name_markers(LABELS).known[label] in CHAIR:
            points[:, m] = waist + [0.9, 0.3 if label[0] == "L" else -0.3, -0.7]
    motion = solve(Capture("chair", markers=MarkerCloud(points, 15.0, LABELS)), SolveSettings(contacts=False)).motion
    off = np.linalg.norm(motion.joints - take.joints, axis=-1)
    assert off[:, :22].mean() < 0.02
    (found,) = [item for item in recorded_diagnostics(motion) if item.code == "markers_off_place"]
    named = {place for label, place in name_markers(LABELS).known.items() if label in found.where.markers}
    assert named == {place for place in CHAIR if place in name_markers(LABELS).known.values()}
    assert "so their names are not used" in sentence(found)


@pytest.mark.slow
def test_a_horse_is_no_person() -> None:
    cloud = MarkerCloud(horse_markers(24, 15.0), 15.0, NAMES)
    motion = solve(Capture("horse", markers=cloud), SolveSettings(contacts=False)).motion
    found = recorded_diagnostics(motion)
    with pytest.raises(ResultRefused, match="do not fit a person"):
        refuse_errors(found, (), "horse")
    assert all(item.severity is not Severity.ERROR for item in refuse_errors(found, ("markers_of_nobody",), "horse"))


@pytest.mark.parametrize(
    ("place", "metres", "far"),
    [
        ("LSHN", 0.155, False), ("LSHN", 0.25, True), ("RBAC", 0.2, False), ("SACR", 0.14, False), ("C7", 0.14, True),
        ("@left_knee", 0.4, False), ("=left_knee", 0.4, False),
    ],
)  # fmt: skip
def test_how_far_markers_may_be(place: str, metres: float, far: bool) -> None:
    assert off_place((place,), np.array([metres])) == ([0] if far else [])
