"""What the add-on keeps about each capture of a scene, and about looking at its takes."""

from __future__ import annotations

import bpy

from .locations import RELATIVE
from .marker_properties import MocapMarker


class MocapMessage(bpy.types.PropertyGroup):
    """One sentence about a capture."""

    text: bpy.props.StringProperty(name="Text")
    is_problem: bpy.props.BoolProperty(name="Problem")


class MocapCamera(bpy.types.PropertyGroup):
    """One camera of the capture."""

    seen_percent: bpy.props.FloatProperty(
        name="Seen", description="Share of the keypoints it sees", subtype="PERCENTAGE"
    )
    has_footage: bpy.props.BoolProperty(name="Footage", description="Footage was found")
    object: bpy.props.PointerProperty(type=bpy.types.Object, name="Camera")
    detections: bpy.props.PointerProperty(type=bpy.types.Object, name="Detections")


class MocapPin(bpy.types.PropertyGroup):
    """A pose the solver must keep."""

    frame: bpy.props.IntProperty(name="Frame", description="Scene frame")
    job_values: bpy.props.StringProperty(name="Pose", description="The pose as it stands in the job file")


def _recolour(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from .bone_colours import colour_bones

    colour_bones(context.scene)


class MocapReview(bpy.types.PropertyGroup):
    """What is looked at."""

    armature: bpy.props.PointerProperty(type=bpy.types.Object, name="Body", description="Armature of the solved body")
    colours: bpy.props.BoolProperty(
        name="Colour Bones",
        description="Paint each bone by its joint's confidence on the current frame; shown in pose mode",
        update=_recolour,
    )
    below: bpy.props.FloatProperty(
        name="Doubtful Below", description="Confidence below which a frame deserves a look",
        default=0.5, min=0.02, max=0.98,
    )  # fmt: skip
    first: bpy.props.IntProperty(name="First", description="First scene frame to solve again", default=1)
    last: bpy.props.IntProperty(name="Last", description="Last scene frame to solve again", default=1)
    pins: bpy.props.CollectionProperty(type=MocapPin)

    @property
    def take(self) -> bpy.types.Action | None:
        """The solved action that the body plays now."""
        animation = self.armature.animation_data if self.armature is not None else None
        action = animation.action if animation is not None else None
        return action if action is not None and "motion_file" in action else None


def _colour_markers(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from .marker_view import colour_markers

    colour_markers(context.scene)


class MocapCapture(bpy.types.PropertyGroup):
    """One capture of the scene."""

    source: bpy.props.StringProperty(
        name="Source", description="File or folder it was read from", subtype="FILE_PATH", options=RELATIVE
    )
    file: bpy.props.StringProperty(
        name="Capture File", description="Capture file made of it", subtype="FILE_PATH", options=RELATIVE
    )
    name: bpy.props.StringProperty(name="Name")
    frames: bpy.props.IntProperty(name="Frames")
    fps: bpy.props.FloatProperty(name="Frame Rate")
    frame_start: bpy.props.IntProperty(name="First Frame", default=1)
    joint_set: bpy.props.StringProperty(name="Keypoints")
    markers: bpy.props.IntProperty(name="Markers")
    marker_items: bpy.props.CollectionProperty(type=MocapMarker)
    marker_index: bpy.props.IntProperty(name="Marker")
    subjects: bpy.props.StringProperty(name="Subjects", description="Prefixes of the markers' labels")
    cloud: bpy.props.PointerProperty(type=bpy.types.Object, name="Marker Object")
    show_names: bpy.props.BoolProperty(name="Names", description="Show the markers' names beside them in the viewport")
    show_residuals: bpy.props.BoolProperty(
        name="Residuals", default=True, update=_colour_markers,
        description="Colour markers by their distance from the solved body: green up to 10 mm, orange up to 25, or red",
    )  # fmt: skip
    cameras: bpy.props.CollectionProperty(type=MocapCamera)
    messages: bpy.props.CollectionProperty(type=MocapMessage)
    collection: bpy.props.PointerProperty(type=bpy.types.Collection, name="Collection")
    floor: bpy.props.PointerProperty(type=bpy.types.Object, name="Floor")
    review: bpy.props.PointerProperty(type=MocapReview)

    def owns(self, obj: bpy.types.Object) -> bool:
        """Return whether an object is the capture's body, its skin, or anything else in its collection."""
        body = self.review.armature
        if body is not None and (obj == body or obj.find_armature() == body):
            return True
        return self.collection is not None and self.collection.all_objects.get(obj.name) == obj


CAPTURE_CLASSES = (MocapMessage, MocapCamera, MocapMarker, MocapPin, MocapReview, MocapCapture)
"""In the order of registration."""
