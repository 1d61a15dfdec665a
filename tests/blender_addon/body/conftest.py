"""The rig posed and compared with the model."""

from __future__ import annotations

import pytest

from blender_addon.body.body_file import BodyFile
from blender_addon.body.rig import Rig
from tests.support.posed_rig import Compare, distances_mm


@pytest.fixture
def compare(rig: Rig, body: BodyFile) -> Compare:
    """Return a function that poses the rig and returns its largest distances from the model in mm: joints, skin."""
    return lambda rotvec: distances_mm(rig, body, rotvec)
