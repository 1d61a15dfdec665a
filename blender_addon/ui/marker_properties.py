"""What the add-on keeps about each marker of a capture."""

from __future__ import annotations

import bpy

from ..conventions.naming import MARKERS
from ..conventions.skeleton import JOINTS

MEANING_ITEMS = (
    ("known", "Known", "A layout knows its label"),
    ("unknown", "Unknown", "No layout knows its label"),
    ("computed", "Computed", "A program computed it: a joint centre or the axis of a segment, not a marker"),
    ("doubled", "Doubled", "Another marker has its place"),
    ("unlabelled", "Unlabelled", "Nobody named it"),
)


BONE_ITEMS = (
    ("AUTO", "By Itself", "By its label; without a known one, the solve finds the bone that it moves with"),
    ("NONE", "Nothing", "It is left out of the solve"),
    *(
        (joint, joint.replace("_", " ").capitalize(), f"The bone of {joint}, wherever it sits on it")
        for joint in JOINTS[:-2]
    ),
)
"""What a marker may be attached to by hand; the ends of hands are no bones that markers determine."""


NAME_ITEMS = (
    ("NONE", "No Marker", "The point is not a marker of the person"),
    *((name, name, f"The point is {name}") for name in MARKERS),
)
"""What a point may be labelled as."""


class MocapPointLabel(bpy.types.PropertyGroup):
    """A user-assigned label of a point; its name is the track's label."""

    point: bpy.props.IntProperty(name="Track", description="Column of the recording, from 0")
    frame: bpy.props.IntProperty(name="Frame", description="Frame of the recording, from 0")
    marker: bpy.props.StringProperty(
        name="Marker", description="What it is; empty for a point that is not the person's"
    )


class MocapMarker(bpy.types.PropertyGroup):
    """One marker of the capture; its name is its label."""

    meaning: bpy.props.EnumProperty(name="Meaning", description="Meaning of its label", items=MEANING_ITEMS)
    gaps: bpy.props.IntProperty(name="Gaps", description="Stretches of frames in which it is not seen")
    missing_percent: bpy.props.FloatProperty(
        name="Missing", description="Share of the frames in which it is not seen", subtype="PERCENTAGE"
    )
    bone: bpy.props.EnumProperty(name="Moves With", description="Bone that it is attached to", items=BONE_ITEMS)

    @property
    def place(self) -> str | None:
        """Its place as a layout file states it, None where nothing is set by hand."""
        return {"AUTO": None, "NONE": ""}.get(self.bone, f"@{self.bone}")
