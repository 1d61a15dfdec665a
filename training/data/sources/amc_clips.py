"""Acclaim skeletons and motions (ASF and AMC) as recorded clips."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing, NonFiniteData
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.motions.recorded_clip import HIP_SPLAY, RecordedClip

FPS = 120.0  # CMU's rate; the files do not state it.
_TPOSE = {
    "lfemur": (0.0, 0.0, -HIP_SPLAY),
    "rfemur": (0.0, 0.0, HIP_SPLAY),
    "lowerneck": (-0.279, 0.0, 0.0),
    "upperneck": (0.367, 0.0, 0.0),
    "head": (0.192, 0.0, 0.0),
    "lhumerus": (0.0, 0.0, -0.14),
    "rhumerus": (0.0, 0.0, 0.14),
}
"""Rotation vectors of the T-pose, as the other conversions of the same recordings hold it."""
_DOF = ("rx", "ry", "rz")


@dataclass(frozen=True)
class AcclaimSkeleton:
    """Bones, parents before children."""

    names: list[str]
    parents: np.ndarray  # (J,)
    axes: np.ndarray  # (J, 3, 3) frames in which each bone's angles are given.
    dofs: list[tuple[str, ...]]  # Angles of each bone, of rx, ry and rz; the root's come after its position.


def read_asf(path: Path) -> AcclaimSkeleton:
    """Read a skeleton.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is no ASF file.
    """
    if not path.is_file():
        raise FileMissing("The skeleton is missing.", where=path.name)
    text = path.read_text(encoding="ascii", errors="replace")
    try:
        bones = [_bone(block) for block in text.split(":bonedata")[1].split(":hierarchy")[0].split("begin")[1:]]
        lines = text.split(":hierarchy")[1].split("begin")[1].split("end")[0].split("\n")
        parent = {child: words[0] for words in map(str.split, lines) for child in words[1:]}
        known = {"root": ((0.0, 0.0, 0.0), _DOF)} | {name: (axis, dof) for name, axis, dof in bones}
        names = ["root"]
        for name in names:
            names += [child for child in known if parent.get(child) == name]
        parents = np.array([-1] + [names.index(parent[name]) for name in names[1:]])
    except (IndexError, KeyError, ValueError) as error:
        raise FileDamaged("The file is not an ASF skeleton.", where=path.name, hint=str(error)) from error
    axes = _euler(np.radians([known[name][0] for name in names]))
    return AcclaimSkeleton(names, parents, axes, [known[name][1] for name in names])


def read_amc(path: Path, skeleton: AcclaimSkeleton) -> RecordedClip:
    """Read a motion, gzipped or not.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it does not fit the skeleton.
        NonFiniteData: an angle is NaN or infinite.
    """
    if not path.is_file():
        raise FileMissing("The motion is missing.", where=path.name)
    try:
        with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as stream:
            rows = _rows(stream.read())
        angles = np.stack([_angles(rows, name, dof) for name, dof in zip(skeleton.names, skeleton.dofs, strict=True)])
    except (OSError, KeyError, ValueError) as error:
        raise FileDamaged("The motion does not fit its skeleton.", where=path.name, hint=str(error)) from error
    if not np.isfinite(angles).all():
        raise NonFiniteData("An angle of the motion is not a number.", where=path.name)
    turn = skeleton.axes[:, None] @ _euler(np.radians(angles)) @ np.swapaxes(skeleton.axes, 1, 2)[:, None]
    tpose = np.array([_TPOSE.get(name, (0.0, 0.0, 0.0)) for name in skeleton.names])
    name = path.name.split(".")[0]
    return RecordedClip(name, skeleton.names, skeleton.parents, log_so3(np.swapaxes(turn, 0, 1)), tpose, FPS)


def _bone(block: str) -> tuple[str, tuple[float, ...], tuple[str, ...]]:
    fields = {words[0]: words[1:] for words in map(str.split, block.split("end")[0].split("\n")) if words}
    axis = tuple(float(value) for value in fields["axis"][:3])
    return fields["name"][0], axis, tuple(d for d in fields.get("dof", []) if d in _DOF)


def _rows(text: str) -> dict[str, list[list[float]]]:
    """Return the numbers of every bone, frame by frame."""
    rows: dict[str, list[list[float]]] = {}
    for line in text.splitlines():
        words = line.split()
        if len(words) > 1 and not line.startswith(("#", ":")):
            rows.setdefault(words[0], []).append([float(word) for word in words[1:]])
    return rows


def _angles(rows: dict[str, list[list[float]]], name: str, dof: tuple[str, ...]) -> np.ndarray:
    """Return (F, 3) degrees about x, y, z, zero where a bone cannot turn."""
    out = np.zeros((len(rows["root"]), 3))
    if dof:
        values = np.array(rows[name])
        out[:, [_DOF.index(d) for d in dof]] = values[:, -len(dof) :]
    return out


def _euler(radians: np.ndarray) -> np.ndarray:
    """Return ``R_z R_y R_x`` of (..., 3) angles about x, y, z."""
    x, y, z = (exp_so3(radians[..., k : k + 1] * np.eye(3)[k]) for k in range(3))
    return z @ y @ x
