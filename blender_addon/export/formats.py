"""Tables of export formats and of the programs that read them. This module does not import the writers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """A file format for takes, with its suffix, label, description, writer and layout options."""

    suffix: str  # File suffix with its dot.
    label: str  # Label for users.
    description: str  # Description of the file's contents, for users.
    writer: str  # Module and function in ``writers`` that write a take to a file.
    keeps: tuple[str, ...] = ()  # Fields of ``FileLayout`` that the user can choose. The format determines all others.
    is_sampled: bool = True  # True if the motion is sampled at any rate and range. If False, its keys are written.


_SKINNED, _BONES = "Skeleton, skinned mesh and motion", ("root", "fingers")
_RIGGED = "Rig, controls, skin and take, to append or link"
_VRM = "Motion of humanoid bones for VRM characters, in metres, Y up"
_POSES = "Pose and shape parameters with jaw and eyes, as in SMPL-X"
FORMATS: dict[str, Format] = {
    "bvh": Format(".bvh", "BVH", "Skeleton and rotations in centimetres, Y up", "joint_tables.export_bvh", _BONES),
    "fbx": Format(".fbx", "FBX", f"{_SKINNED}, Y up", "blender_exporters.export_fbx", ("unit", "up", *_BONES, "node")),
    "gltf": Format(".glb", "glTF", f"{_SKINNED} in metres, Y up", "blender_exporters.export_gltf", _BONES),
    "vrma": Format(".vrma", "VRM Animation", _VRM, "vrm_animation.export_vrma"),
    "usd": Format(".usdc", "USD", f"{_SKINNED} in metres, Z up", "blender_exporters.export_usd", _BONES),
    "alembic": Format(".abc", "Alembic", "Vertices of every frame in metres, Y up", "blender_exporters.export_alembic"),
    "amass": Format(".npz", "AMASS", "Pose and shape parameters of an SMPL-type body, Z up", "amass.export_amass"),
    "amass-x": Format(".npz", "AMASS, SMPL-X", f"{_POSES}, Z up", "amass.export_amass_x"),
    "blend": Format(".blend", "Blend", f"{_RIGGED}, Z up", "blender_exporters.export_blend", is_sampled=False),
    "trc": Format(".trc", "TRC", "Joint positions for OpenSim in millimetres, Y up", "joint_tables.export_trc"),
    "csv": Format(".csv", "CSV", "Joint positions as a table in metres, Z up", "joint_tables.export_csv"),
}
"""Formats, keyed by the names that settings and command lines use."""
ROOT_MOTIONS = (
    ("body", "On Hips", "The hips carry the travel over the ground"),
    ("root", "On Root", "A root bone carries the travel and the heading, smoothed"),
    ("place", "In Place", "The motion has no travel"),
)
"""Choices for storing the travel over the ground: identifier, label and description."""
UNITS = (
    ("m", "Metres", "One file unit is a metre"),
    ("cm", "Centimetres", "One file unit is a centimetre, without a scale on the skeleton"),
)
"""Length units of FBX files."""
UP_AXES = (
    ("Y", "Y Up", "Y points up, -Z points forward"),
    ("Z", "Z Up", "Z points up, as in Blender"),
)  # Up axes of FBX files.


@dataclass(frozen=True)
class FileLayout:
    """Layout of the skeleton in a file. BVH, FBX, glTF and USD follow it as far as the format allows."""

    unit: str = "m"  # Key of ``UNITS``. Only FBX uses it.
    up: str = "Y"  # Key of ``UP_AXES``. Only FBX uses it.
    root: str = "body"  # Key of ``ROOT_MOTIONS``.
    fingers: bool = True  # Keep finger bones. If False, hand bones move the skin of the fingers.
    node: str = ""  # Name of the skeleton object in the file, or "" for the armature's own name.

    @property
    def metres_a_unit(self) -> float:
        """Length of one unit of the exported file in metres."""
        return 0.01 if self.unit == "cm" else 1.0


AS_RECORDED = FileLayout()  # Metres, Y up, travel stored on the hips, with fingers and with the armature's name.


@dataclass(frozen=True)
class Destination:
    """A program that imports takes, with the file format and layout that it needs."""

    label: str  # Name of the program.
    format: str  # Key of ``FORMATS``.
    description: str  # Description of the file's contents, for users.
    layout: FileLayout


_UNREAL = FileLayout(unit="cm", root="root", node="Armature")
_UNITY = "FBX in metres, with the travel on the hips, as humanoid rigs expect"
_BLENDER = "Blender file with the rig, its controls, its skin and the take, to append or link"
DESTINATIONS: dict[str, Destination] = {
    "unreal": Destination("Unreal", "fbx", "FBX in centimetres with root motion on a root bone", _UNREAL),
    "unity": Destination("Unity", "fbx", _UNITY, AS_RECORDED),
    "maya": Destination("Maya", "fbx", "FBX in centimetres, Y up, with the travel on the hips", FileLayout("cm")),
    "godot": Destination("Godot", "gltf", "glTF in metres with root motion on a root bone", FileLayout(root="root")),
    "vrm": Destination("VRM", "vrma", "VRM Animation, which every VRM character can play", AS_RECORDED),
    "three.js": Destination("three.js", "gltf", "glTF in metres, with the travel on the hips", AS_RECORDED),
    "blender": Destination("Blender", "blend", _BLENDER, FileLayout(up="Z")),
}
"""Programs, keyed by the names that settings and command lines use. Unreal's importer skips an object named Armature,
so that the root bone becomes the root of the skeleton."""
