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
    is_sampled: bool = True
    """The motion is sampled, at any frame rate and in any range; otherwise its keys are written as they are."""
    keeps: tuple[str, ...] = ()
    """Fields of ``FileLayout`` that can be chosen; the format states all others itself."""


FORMATS: dict[str, Format] = {
    "bvh": Format(".bvh", "BVH", "Skeleton and rotations; centimetres, Y up", keeps=("root", "fingers")),
    "fbx": Format(
        ".fbx", "FBX", "Skeleton, skinned mesh and motion; Y up", keeps=("unit", "up", "root", "fingers", "node")
    ),
    "gltf": Format(".glb", "glTF", "Skeleton, skinned mesh and motion; metres, Y up", keeps=("root", "fingers")),
    "usd": Format(".usdc", "USD", "Skeleton, skinned mesh and motion; metres, Z up", keeps=("root", "fingers")),
    "alembic": Format(".abc", "Alembic", "Vertices of every frame; metres, Y up"),
    "amass": Format(".npz", "AMASS", "Pose and shape parameters of an SMPL-type body; Z up"),
    "amass-x": Format(".npz", "AMASS, SMPL-X", "The same with jaw and eyes at rest, as SMPL-X has them; Z up"),
    "blend": Format(".blend", "Blend", "Rig, controls, skin and take, to append or link; Z up", is_sampled=False),
    "trc": Format(".trc", "TRC", "Joint positions for OpenSim; millimetres, Y up"),
    "csv": Format(".csv", "CSV", "Joint positions as a table; metres, Z up"),
}
"""By the names that settings and command lines use."""
