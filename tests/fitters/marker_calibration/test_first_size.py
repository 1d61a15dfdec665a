"""Children are small from the start of a calibration: fitted as adults they crouch, and their knees end elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import ON_BONE, marker_landmarks, marker_layout
from solver_backend.fitters.marker_calibration.calibrate import first_shape
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.types import Capture
from tests.support.worn_markers import worn_markers

PLUGIN_GAIT = marker_layout("PLUGIN_GAIT_39")
LEGS = tuple(label for label in PLUGIN_GAIT if label[1:] in ("ASI", "PSI", "KNE", "TIB", "ANK", "HEE", "TOE"))
FEW = ("C7", "SACR", "LKNE", "RKNE", "LANK", "RANK", "LELB", "RELB", "LWRA", "RWRA")


def leg(betas: np.ndarray) -> float:
    rest = load_body().rest_joints(betas)
    return float(rest[1, 1] - rest[7, 1])


@pytest.mark.parametrize("size", [0.65, 0.8, 1.2])
@pytest.mark.parametrize("labels", [PLUGIN_GAIT, LEGS, FEW], ids=["whole", "legs", "few"])
def test_the_size_shows_by_markers_that_keep_their_distance(labels: tuple[str, ...], size: float) -> None:
    body, worn = load_body(), worn_markers(labels, 12, step=20)
    found = first_shape(body, marker_landmarks(body, tuple(labels)), size * worn.cloud.positions)
    assert leg(found) == pytest.approx(size * leg(worn.betas), rel=0.12)


def test_people_of_usual_size_start_at_the_mean_body_and_so_do_markers_without_places() -> None:
    body, worn = load_body(), worn_markers(PLUGIN_GAIT, 12, step=20)
    assert not first_shape(body, marker_landmarks(body, PLUGIN_GAIT), worn.cloud.positions).any()
    loose = marker_landmarks(body, tuple(f"{ON_BONE}left_knee" for _ in PLUGIN_GAIT))
    assert not first_shape(body, loose, 0.5 * worn.cloud.positions).any()


def test_a_childs_markers_stay_at_their_places() -> None:
    """1.12 m: as an adult, both knees are 0.2 m from where the child has them, and their names are not believed."""
    worn = worn_markers(PLUGIN_GAIT, 8, step=30)
    cloud = replace(worn.cloud, positions=0.66 * worn.cloud.positions)
    found = calibrate_person([Capture("child", markers=cloud)])
    assert leg(found.betas) == pytest.approx(0.66 * leg(worn.betas), rel=0.06)
    assert len(found.labels) == len(PLUGIN_GAIT) and not any(place.startswith(ON_BONE) for place in found.places)
