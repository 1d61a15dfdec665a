"""The table of formats; what writes them is in ``write.py``, so that the table costs nothing to load."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """One way to write a take."""

    suffix: str
    """Of the file, with its dot."""
    label: str
    """For people."""
    description: str
    """What the file holds."""


FORMATS: dict[str, Format] = {
    "bvh": Format(".bvh", "BVH", "Skeleton and rotations; centimetres, Y up"),
    "fbx": Format(".fbx", "FBX", "Skeleton, skinned mesh and motion; Y up"),
    "gltf": Format(".glb", "glTF", "Skeleton, skinned mesh and motion; metres, Y up"),
    "usd": Format(".usdc", "USD", "Skeleton, skinned mesh and motion; metres, Z up"),
    "alembic": Format(".abc", "Alembic", "Vertices of every frame; metres, Y up"),
    "amass": Format(".npz", "AMASS", "Pose and shape parameters of an SMPL-type body; Z up"),
    "amass-x": Format(".npz", "AMASS, SMPL-X", "The same with jaw and eyes at rest, as SMPL-X has them; Z up"),
    "trc": Format(".trc", "TRC", "Joint positions for OpenSim; millimetres, Y up"),
    "csv": Format(".csv", "CSV", "Joint positions as a table; metres, Z up"),
}
"""By the names that settings and command lines use."""
