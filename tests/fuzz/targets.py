"""Every reader of both halves, and verbs that read, through their public entries."""

from __future__ import annotations

from tests.fuzz import (
    capture_targets,
    foreign_targets,
    marker_targets,
    motion_targets,
    rig_targets,
    sensor_targets,
    studio_targets,
)
from tests.fuzz.target import Target
from tests.fuzz.verbs import blender, markers, motions, sensors, studio, videos, views

TARGETS: tuple[Target, ...] = (
    *capture_targets.TARGETS,
    *motion_targets.TARGETS,
    *marker_targets.TARGETS,
    *rig_targets.TARGETS,
    *studio_targets.TARGETS,
    *sensor_targets.TARGETS,
    *foreign_targets.TARGETS,
    *views.TARGETS,
    *markers.TARGETS,
    *motions.TARGETS,
    *sensors.TARGETS,
    *studio.TARGETS,
    *videos.TARGETS,
    *blender.TARGETS,
)


def chosen(only: str) -> list[Target]:
    """Return those whose name begins so; ``readers`` are all but the verbs."""
    if only == "readers":
        return [target for target in TARGETS if not target.name.startswith("verb")]
    return [target for target in TARGETS if target.name.startswith(only)]
