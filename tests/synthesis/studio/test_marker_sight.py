"""Markers' sight told without a picture is the picture's for nine markers in ten, and faults go by it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.native.capture_file import read_capture
from solver_backend.synthesis.studio.data_set import SHOTS, make_data_set
from solver_backend.synthesis.studio.make_shot import film
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots, set_up
from solver_backend.synthesis.studio.truth import marker_sight

ARRAY = {"preset": "azure_kinect_3", "count": 4}


def refuse(kind: str, view: int, frame: int, picture: np.ndarray) -> None:
    """Take no picture: colour is Blender's, and only what is seen of the markers is drawn here."""
    raise AssertionError(kind)


@pytest.mark.slow
def test_sight_lines_see_what_the_picture_shows() -> None:
    look = {"preset": "suit", "furniture": 3}
    spec = spec_of(
        {
            "camera_arrays": [ARRAY],
            "frames": 10,
            "fps": 2,
            "looks": [look],
            "film": ["rgb"],
            "people": {"count": 2, "sigma": 1.5},
        }
    )
    for shot in list_shots(spec):
        stage = set_up(spec, shot)
        drawn = film(spec, stage, refuse)
        shared = marker_sight(stage)
        assert 0.4 < (drawn > 0.5).mean() < 0.8
        assert ((drawn > 0.5) == (shared > 0.5)).mean() > 0.9


def test_a_marker_that_too_few_cameras_see_is_lost(tmp_path: Path) -> None:
    given = {"camera_arrays": [ARRAY], "frames": 6, "fps": 2, "film": [], "perturb": {"marker_views": 2}}
    make_data_set(spec_of(given), tmp_path)
    shot = next(path for path in (tmp_path / SHOTS).iterdir() if not path.name.startswith("."))
    clean, perturbed = (read_capture(shot / f"{name}.npz") for name in ("clean", "perturbed"))
    seen = (np.asarray(clean.truth["marker_seen"]) > 0.5).sum(axis=0)
    assert clean.markers is not None and perturbed.markers is not None
    gone = np.isnan(perturbed.markers.positions).any(axis=-1)
    assert np.array_equal(gone, seen < 2) and gone.any() and not gone.all()
    assert np.array_equal(perturbed.markers.positions[~gone], clean.markers.positions[~gone])
