"""Read and write skeleton files, which pass a moving skeleton to the solver."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import FileDamaged, MotionInvalid, NonFiniteData
from .npz import write_npz
from .plausible import FARTHEST_IN_UNITS, require_rate, require_within
from .schema import read_fields

FORMAT, VERSION = "manifold_mocap_skeleton", 1
_ARRAYS = ("format", "version", "name", "names", "parents", "rest", "joints", "turns", "fps", "roles")

_OFF = 1e-3
"""Largest deviation of R R^T from the identity, the same as for cameras. Files store six digits."""


@dataclass(frozen=True)
class SkeletonMotion:
    """Motion of a skeleton over F frames, with Z up. The rest positions are in the skeleton's own axes."""

    name: str
    names: tuple[str, ...]
    """(J,) joint names, parents before children. Chain ends count as joints and take their parent's name."""
    parents: tuple[int, ...]  # Index of each joint's parent, -1 for the root.
    rest: np.ndarray  # (J, 3) positions at zero rotation, in metres (in files, in any unit).
    joints: np.ndarray  # (F, J, 3) positions in the same unit.
    turns: np.ndarray  # (F, J, 3, 3) rotations from rest axes to the world.
    fps: float

    def __post_init__(self) -> None:
        """Raise ``MotionInvalid`` if there are no frames, equal names or impossible numbers."""
        if not len(self.joints):
            raise MotionInvalid("The motion has no frames.", where=self.name)
        require_distinct(self.names, self.name)
        require_rate(self.fps, MotionInvalid, self.name)
        for name in ("rest", "joints"):
            require_within(name, getattr(self, name), FARTHEST_IN_UNITS, MotionInvalid, self.name)
        with np.errstate(over="ignore", invalid="ignore"):  # numbers that overflow are not a rotation
            off = np.abs(self.turns @ np.swapaxes(self.turns, -1, -2) - np.eye(3)).max((0, 2, 3))
        wrong = ~(off <= _OFF)
        if not wrong.any():
            wrong = (np.linalg.det(self.turns) < 0).any(0)
        if wrong.any():
            joint = int(np.argmax(wrong))
            what = f"The matrices of the joint '{self.names[joint]}' are not rotations (|R Rᵀ - I| = {off[joint]:.3g})."
            raise MotionInvalid(what, where=self.name, hint="Export it without scale and shear.")

    @property
    def num_frames(self) -> int:
        """Number of frames F of the motion."""
        return len(self.joints)


def require_distinct(names: tuple[str, ...], where: str) -> None:
    """Raise ``MotionInvalid`` if two joints have the same name."""
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise MotionInvalid(f"Several joints are called '{twice}'.", where=where, hint="Give each joint a unique name.")


@dataclass(frozen=True)
class SkeletonFile(SkeletonMotion):
    """A skeleton's motion with the roles of its joints, as stored in a file."""

    roles: dict[str, str]  # Joint for each role, empty if the writer did not know the roles.


def write_skeleton(path: Path, skeleton: SkeletonFile, *, overwrite: bool = False) -> None:
    """Write a skeleton file completely, or not at all."""
    arrays = {key: np.array(getattr(skeleton, key)) for key in ("name", "names", "parents", "rest", "joints", "turns")}
    arrays |= {"format": np.array(FORMAT), "version": np.array(VERSION), "fps": np.array(skeleton.fps)}
    write_npz(path, {**arrays, "roles": np.array(json.dumps(skeleton.roles))}, overwrite=overwrite)


def read_skeleton(path: Path) -> SkeletonFile:
    """Read a skeleton file.

    Raises:
        MotionInvalid: it has no frames, or the parents do not form a tree.
    """
    fields = read_fields(path, _ARRAYS)
    fields.require_format(FORMAT, VERSION)
    names = fields.texts("names")
    count = len(names)
    rest, joints = fields.numbers("rest", (count, 3)), fields.numbers("joints", (None, count, 3))
    turns = fields.numbers("turns", (len(joints), count, 3, 3))
    above = fields.numbers("parents", (count,))
    for name, value in {"rest": rest, "joints": joints, "turns": turns, "parents": above}.items():
        if not np.isfinite(value).all():
            raise NonFiniteData(f"'{name}' contains NaN or infinite values.", where=str(path))
    parents = tuple(int(parent) for parent in above)
    if not len(joints) or any(not -1 <= parent < j for j, parent in enumerate(parents)):
        raise MotionInvalid("The skeleton has no frames, or its parents are not a tree.", where=str(path))
    fps = fields.number("fps")
    if not 0 < fps < np.inf:
        raise NonFiniteData(f"The frame rate must be a positive number, not {fps}.", where=str(path))
    try:
        roles = json.loads(fields.text("roles", "{}"))
    except (ValueError, RecursionError) as error:
        raise FileDamaged("The roles are not valid JSON.", where=str(path)) from error
    roles = {str(role): str(name) for role, name in roles.items() if name in names} if isinstance(roles, dict) else {}
    return SkeletonFile(fields.text("name", path.stem), names, parents, rest, joints, turns, fps, roles)
