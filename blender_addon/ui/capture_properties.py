"""What the add-on keeps about each capture of a scene, and about looking at its takes."""

from __future__ import annotations

import bpy

from .._exchange.diagnostics import Diagnostic
from ..conventions.kept_findings import findings_in
from ..conventions.naming import MARKERS
from ..conventions.skeleton import JOINTS
from .project_files import RELATIVE
from .tags import TaggedObject, active_name, active_object, find_collection, give_tag, tag_of

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


class MocapMessage(bpy.types.PropertyGroup):
    """One thing that was found about a capture."""

    text: bpy.props.StringProperty(name="Text")
    is_problem: bpy.props.BoolProperty(name="Problem")
    cameras: bpy.props.StringProperty(name="Cameras", description="Names of the cameras it is about, a line each")
    diagnostic: bpy.props.StringProperty(name="Finding", description="What was found, as text of JSON")

    @property
    def found(self) -> tuple[Diagnostic, ...]:
        """What was found."""
        return findings_in(self.diagnostic)


class MocapCamera(bpy.types.PropertyGroup):
    """One camera of the capture."""

    seen_percent: bpy.props.FloatProperty(
        name="Seen", description="Share of the keypoints it sees", subtype="PERCENTAGE"
    )
    has_footage: bpy.props.BoolProperty(name="Footage", description="Footage was found")
    use: bpy.props.BoolProperty(name="Use", description="Solve with what this camera sees", default=True)
    before_px: bpy.props.FloatProperty(name="Before", description="Median distance of its detections as calibrated, px")
    after_px: bpy.props.FloatProperty(name="After", description="The same with the refined cameras, px")
    camera_tag: bpy.props.StringProperty(name="Camera")
    detections_tag: bpy.props.StringProperty(name="Detections")
    object = TaggedObject("camera_tag")
    detections = TaggedObject("detections_tag")


class MocapLeftOut(bpy.types.PropertyGroup):
    """Frames in which a camera takes no part in the solve."""

    name: bpy.props.StringProperty(name="Camera")
    first: bpy.props.IntProperty(name="First", description="First scene frame in which the camera is left out")
    last: bpy.props.IntProperty(name="Last", description="Last scene frame in which the camera is left out")


class MocapPin(bpy.types.PropertyGroup):
    """A pose the solver must keep."""

    frame: bpy.props.IntProperty(name="Frame", description="Scene frame")
    job_values: bpy.props.StringProperty(name="Pose", description="The pose as it stands in the job file")


def _recolour(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from .viewport import colour_bones

    colour_bones(context.scene)


def _lift(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Lay the floor offset on the body's own offset, which no key touches."""
    armature = self.armature
    if armature is not None:
        armature.delta_location.z = self.floor_offset


class MocapReview(bpy.types.PropertyGroup):
    """What is looked at."""

    body_tag: bpy.props.StringProperty(name="Body", description="Tag of the solved body's armature")
    armature = TaggedObject("body_tag", prefer_active=True)
    colours: bpy.props.BoolProperty(
        name="Colour Bones",
        description="Paint each bone by its joint's confidence on the current frame; shown in pose mode",
        update=_recolour,
    )
    below: bpy.props.FloatProperty(
        name="Review Threshold", description="Confidence below which a frame deserves a look",
        default=0.5, min=0.02, max=0.98,
    )  # fmt: skip
    floor_offset: bpy.props.FloatProperty(
        name="Floor Offset", description="Lifts or lowers the body over the floor in all its takes; no key is changed",
        unit="LENGTH", soft_min=-0.2, soft_max=0.2, precision=4, step=0.1, update=_lift,
    )  # fmt: skip
    first: bpy.props.IntProperty(name="First", description="First scene frame to solve again", default=1)
    last: bpy.props.IntProperty(name="Last", description="Last scene frame to solve again", default=1)
    pins: bpy.props.CollectionProperty(type=MocapPin)

    def plays(self, obj: bpy.types.Object) -> bool:
        """Return whether an object is the body, a copy of it, or the skin of one."""
        return bool(self.body_tag) and self.body_tag in (tag_of(obj), tag_of(obj.find_armature()))

    @property
    def take(self) -> bpy.types.Action | None:
        """The solved action that the body plays now, also from the NLA."""
        from ..animation.curves import current_action

        armature = self.armature
        action = current_action(armature) if armature is not None else None
        return action if action is not None and "motion_file" in action else None


def _show_person(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Keep to the person chosen from the list until another object is made active, and select their body."""
    body = self.review_of(self.person_shown).armature
    if body is not None and body.name in context.view_layer.objects and context.mode == "OBJECT":
        for other in context.selected_objects:
            other.select_set(False)
        body.select_set(True)
        context.view_layer.objects.active = body
    self.person_active = active_name(self.id_data)


class MocapPerson(bpy.types.PropertyGroup):
    """One of several people that a capture shows."""

    name: bpy.props.StringProperty(name="Name", description="Name of this person; double-click to change")
    key: bpy.props.StringProperty(name="Person", description="Name of this person in the capture file")
    frames: bpy.props.IntProperty(name="Frames", description="Frames in which two or more views see them")
    views: bpy.props.FloatProperty(name="Views", description="How many views see them on average")
    review: bpy.props.PointerProperty(type=MocapReview)


def _colour_markers(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from .viewport import colour_markers

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
    told: bpy.props.CollectionProperty(type=MocapPointLabel)
    told_name: bpy.props.EnumProperty(
        name="Is", description="What the chosen point is; the name holds for as long as its track goes on unbroken",
        items=NAME_ITEMS, default="C7",
    )  # fmt: skip
    subjects: bpy.props.StringProperty(name="Subjects", description="Prefixes of the markers' labels")
    cloud_tag: bpy.props.StringProperty(name="Marker Object")
    cloud = TaggedObject("cloud_tag")
    show_names: bpy.props.BoolProperty(name="Names", description="Show the markers' names beside them in the viewport")
    show_residuals: bpy.props.BoolProperty(
        name="Residuals", default=True, update=_colour_markers,
        description="Colour markers by their distance from the solved body: green to 10 mm, orange to 25 mm, then red",
    )  # fmt: skip
    cameras: bpy.props.CollectionProperty(type=MocapCamera)
    show_agreement: bpy.props.BoolProperty(
        name="Agreement", default=True,
        description="Outline cameras in the viewport: orange where a problem names them, grey where they are not used",
    )  # fmt: skip
    left_out: bpy.props.CollectionProperty(type=MocapLeftOut)
    checked: bpy.props.StringProperty(name="Checked", description="Result of a check of the calibration, line by line")
    doubts: bpy.props.StringProperty(name="Doubts", description="What that check found wrong, as text of JSON")
    doubted: bpy.props.StringProperty(name="Doubted", description="Names of the cameras it found wrong, a line each")
    original: bpy.props.StringProperty(
        name="Original", description="Capture file with the recording's own calibration, where it was refined",
        subtype="FILE_PATH", options=RELATIVE,
    )  # fmt: skip
    messages: bpy.props.CollectionProperty(type=MocapMessage)
    collection_tag: bpy.props.StringProperty(name="Collection")
    floor_tag: bpy.props.StringProperty(name="Floor")
    floor = TaggedObject("floor_tag")
    review: bpy.props.PointerProperty(type=MocapReview)
    people: bpy.props.CollectionProperty(type=MocapPerson)
    person_shown: bpy.props.IntProperty(name="Person", description="Who is solved and reviewed", update=_show_person)
    person_active: bpy.props.StringProperty(name="Active Object when they were chosen")

    @property
    def collection(self) -> bpy.types.Collection | None:
        """The capture's collection, None where it was deleted."""
        return find_collection(self.id_data, self.collection_tag)

    @collection.setter
    def collection(self, collection: bpy.types.Collection | None) -> None:
        self.collection_tag = give_tag(collection)

    def refined_text(self) -> str:
        """Return before and after of a refined calibration, "" where it is the recording's own."""
        pairs = [(item.before_px, item.after_px) for item in self.cameras if item.after_px > 0]
        if not self.original or not pairs:
            return ""
        before, after = (sorted(column)[len(pairs) // 2] for column in zip(*pairs, strict=True))
        return f"{before:.1f} px before, {after:.1f} px after"

    def leave_out(self, scene_fps: float) -> list[str]:
        """Return the views that are left out, in the form of the solver's setting.

        Args:
            scene_fps: the scene's frames per second, by which the ranges are laid.
        """
        unused = [item.name for item in self.cameras if not item.use]
        ratio = self.fps / scene_fps if self.fps else 1.0
        ranges: list[str] = []
        for item in self.left_out:
            first, last = (round((frame - self.frame_start) * ratio) for frame in (item.first, item.last))
            if item.name not in unused and last >= 0 and first < self.frames and first <= last:
                ranges.append(f"{item.name}:{max(0, first)}-{last}")
        return unused + ranges

    @property
    def measured(self) -> str:
        """What takes are solved from: the capture file or, where a motion came without one, that motion."""
        return self.file or (self.source if self.review.armature is not None else "")

    def review_of(self, person: int) -> MocapReview:
        """Return what is looked at of one of the people, by index; of the only one where there are none."""
        return self.people[person].review if 0 < person < len(self.people) else self.review

    @property
    def reviews(self) -> list[MocapReview]:
        """Return what is looked at of each person."""
        return [self.review_of(person) for person in range(max(1, len(self.people)))]

    @property
    def person_index(self) -> int:
        """Return which person panels and operators are about: whose body is active, or who was chosen last."""
        active = active_object(self.id_data)
        if active is not None and active.name_full != self.person_active:
            for person, review in enumerate(self.reviews):
                if review.plays(active):
                    return person
        return min(self.person_shown, max(0, len(self.people) - 1))

    @property
    def person(self) -> MocapPerson | None:
        """Return that person, None where the capture shows one alone."""
        return self.people[self.person_index] if self.people else None

    def person_named(self, key: str) -> int:
        """Return the index of a person by the capture file's name for them; 0 where there is none."""
        return next((index for index, person in enumerate(self.people) if person.key == key), 0)

    def owns(self, obj: bpy.types.Object) -> bool:
        """Return whether an object is the capture's body, its skin, or anything else in its collection."""
        if any(review.plays(obj) for review in self.reviews):
            return True
        collection = self.collection
        return collection is not None and collection.all_objects.get(obj.name) == obj
