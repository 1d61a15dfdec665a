"""A head whose four markers are named a quarter turn off is turned back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.fitters.recipes.live import fit_average_person
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.markers.read import read_markers
from solver_backend.labelling.label_take import AROUND, label_take, with_head_forward
from solver_backend.labelling.outputs import MARKERS
from solver_backend.labelling.point_network import load_network
from solver_backend.labelling.tracklets import tracklets_of
from tests.support.unlabelled_takes import score, stripped

SHOULDERS = tuple(MARKERS.index(name) for name in ("LSHO", "RSHO"))
HEAD = np.array([(0.09, 0.06, 0.3), (-0.09, 0.06, 0.3), (-0.08, -0.06, 0.3), (0.08, -0.06, 0.3)])


def person(frames: int = 40) -> np.ndarray:
    """Return a head that looks to both sides above shoulders, which turn about as well: columns as ``LABELS``."""
    time = np.linspace(0.0, 6.0, frames)
    body, neck = (exp_so3(np.stack([0 * time, 0 * time, a], axis=-1)) for a in (time, 0.8 * np.sin(3 * time)))
    head = HEAD @ np.swapaxes(body @ neck, -1, -2)
    shoulders = np.array([(0.2, 0.0, 0.0), (-0.2, 0.0, 0.0)]) @ np.swapaxes(body, -1, -2)
    return np.concatenate([head, shoulders], axis=1)


LABELS = np.array([*AROUND, *SHOULDERS])


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_names_are_turned_back_to_where_the_shoulders_face(quarter):
    points = person()
    tracklets = tracklets_of(points, 30.0, persistent=True)
    wrong = LABELS.copy()
    wrong[:4] = np.roll(wrong[:4], quarter)
    np.testing.assert_array_equal(with_head_forward(points, tracklets, wrong, {}), LABELS)


def test_assigned_names_and_heads_without_shoulders_are_left():
    points = person()
    tracklets = tracklets_of(points, 30.0, persistent=True)
    wrong = LABELS.copy()
    wrong[:4] = np.roll(wrong[:4], 1)
    np.testing.assert_array_equal(with_head_forward(points, tracklets, wrong, {0: AROUND[1]}), wrong)
    alone = np.where(np.arange(6) < 4, wrong, -1)
    np.testing.assert_array_equal(with_head_forward(points, tracklets, alone, {}), alone)


@pytest.mark.slow
def test_a_tennis_player_whose_head_is_wider_than_long(shared_data: Path):
    cloud = read_markers(shared_data / "markers" / "kineticstoolkit" / "tennis_serve.c3d").cloud
    bare = stripped(replace(cloud, positions=cloud.positions[:200], residual=None), 1)
    found = score(label_take(bare.cloud, load_network(), fit_average_person), bare.truth)
    assert found.right >= 99.0 and found.wrong <= 0.5
