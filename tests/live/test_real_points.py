"""The live loop with the network that ships: a walk, in whatever unit and axes it comes."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.fitters.recipes.live import LiveFit
from solver_backend.io.markers.read import read_markers
from solver_backend.io.units_and_axes import rotation_to_z_up
from solver_backend.labelling.point_network import load_network
from solver_backend.live.frames import from_lines
from solver_backend.live.session import LiveSession


@pytest.fixture
def walk(shared_data) -> np.ndarray:
    cloud = read_markers(shared_data / "markers" / "cmu_pairs" / "02_01.c3d").cloud
    rng = np.random.default_rng(0)
    return np.stack([frame[rng.permutation(len(frame))] for frame in cloud.positions[:40]])


@pytest.mark.parametrize(("unit", "factor", "axis"), [("m", 1.0, "z"), ("mm", 1000.0, "y"), ("cm", 100.0, "-z")])
def test_a_walk_is_followed_in_any_unit_and_axes(walk, unit, factor, axis):
    points = factor * walk @ rotation_to_z_up(axis)
    text = "".join(json.dumps({"t": i / 120, "points": frame.tolist()}) + "\n" for i, frame in enumerate(points))
    session = LiveSession(load_network(), LiveFit(load_body()))
    lines: list[Any] = list(session.run(from_lines(io.BytesIO(text.encode()))))
    world = next(line for line in lines if line.get("event") == "world")
    assert world["message"].startswith(f"Points are in {unit}, {axis} is up")
    poses = [line for line in lines if "pose" in line]
    assert len(poses) == len(walk) - 4
    assert np.median([line["markers"] for line in poses]) >= 39
    assert np.median([line["off_mm"] for line in poses]) < 30
