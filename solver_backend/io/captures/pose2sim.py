"""What a Pose2Sim session states: where its trials lie, and the values in its Config.toml files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver_backend.io.calibration.search import CONFIG
from solver_backend.io.camera_names import natural_key
from solver_backend.io.detections.search import POSE_FOLDERS
from solver_backend.io.files import read_toml
from solver_backend.types import JointSet

SESSION_LEVELS = 3
"""Trials lie at most so deep in a session: session, participant, trial."""
_POSE_MODELS = {joint_set.value: joint_set for joint_set in (JointSet.BODY_25, JointSet.BODY_25B, JointSet.COCO_17)}
_POSE_MODELS |= {"BODY": JointSet.COCO_17, "HALPE_26": JointSet.HALPE_26, "BODY_WITH_FEET": JointSet.HALPE_26}
_POSE_MODELS |= dict.fromkeys(("COCO_133", "WHOLE_BODY"), JointSet.COCO_WHOLEBODY_133)
_POSE_MODELS["BLAZEPOSE"] = JointSet.MEDIAPIPE_33


@dataclass(frozen=True)
class TrialConfig:
    """Values of Config.toml that concern reading; the nearest file that states a value wins."""

    fps: float | None = None
    """Frames per second, None where no file states a number."""
    joint_set: JointSet | None = None
    """Joint set of ``pose_model``, None where unknown."""
    frame_range: tuple[int, ...] = ()
    """Frames Pose2Sim is asked to work on; empty = all."""
    sources: tuple[str, ...] = ()
    """Files that were read."""


def trials_below(root: Path, levels: int = SESSION_LEVELS) -> list[str]:
    """Return the paths, relative to a session's folder, of those below that are recordings of their own."""
    below = sorted((p for p in root.iterdir() if p.is_dir()), key=lambda p: natural_key(p.name))
    found: list[str] = []
    for path in below:
        if any((path / name).is_dir() for name in POSE_FOLDERS):
            found.append(path.name)
        elif levels > 1:
            found += [f"{path.name}/{trial}" for trial in trials_below(path, levels - 1)]
    return found


def read_config(levels: Sequence[Path]) -> TrialConfig:
    """Return what the Config.toml files of a trial and the folders above state; all their lines may be comments.

    Raises:
        FileDamaged: a Config.toml is not TOML.
    """
    fps: float | None = None
    joint_set: JointSet | None = None
    frame_range: tuple[int, ...] = ()
    sources: list[str] = []
    for level in levels:
        path = level / CONFIG
        if not path.is_file():
            continue
        tables = read_toml(path)
        sources.append(str(path))
        project, pose = _table(tables, "project"), _table(tables, "pose")
        fps = fps if fps is not None else _number(project.get("frame_rate"))
        frame_range = frame_range or _range(project.get("frame_range"))
        model = pose.get("pose_model")
        joint_set = joint_set or (_POSE_MODELS.get(model.upper()) if isinstance(model, str) else None)
    return TrialConfig(fps, joint_set, frame_range, tuple(sources))


def _table(tables: dict[str, Any], key: str) -> dict[str, Any]:
    value = tables.get(key)
    return value if isinstance(value, dict) else {}


def _number(value: Any) -> float | None:
    """Return a positive number; 'auto' and the like give None."""
    good = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e5
    return float(value) if good else None


def _range(value: Any) -> tuple[int, ...]:
    good = isinstance(value, list) and len(value) == 2 and all(isinstance(v, int) for v in value)
    return tuple(value) if good else ()
