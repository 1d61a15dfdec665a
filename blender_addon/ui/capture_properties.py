"""Scene data of each capture: its cameras, markers and people, and the review of its takes."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from .._exchange.diagnostics import Diagnostic, notes_in, warnings_in
from ..conventions.kept_findings import findings_in
from ..conventions.naming import MARKERS
from ..conventions.skeleton import JOINTS
from .setting_properties import Items, choice, number, path, switch
from .tags import TaggedObject, active_name, active_object, find_collection, give_tag, tag_of

_BONE_ITEMS = (
    ("AUTO", "Automatic", "Use the label, or the bone that the marker moves with if the label is unknown"),
    ("NONE", "Nothing", "Do not use this marker in the solve"),
    *(
        (joint, joint.replace("_", " ").capitalize(), f"The marker moves with the bone {joint}")
        for joint in JOINTS[:-2]
    ),
)
"""Bones that a marker can move with. Hand ends are not offered, because markers do not determine their rotation."""
_NAME_ITEMS = (
    ("NONE", "No Marker", "The point is not a marker of the person"),
    *((name, name, f"The point is the marker {name}") for name in MARKERS),
)


class MocapCamera(bpy.types.PropertyGroup):
    """Data of one camera of a capture, and whether solves use it."""

    use: switch("Use", "Include this camera in the next solve", on=True)
    seen_percent: float
    has_footage: bool
    before_px: float  # Median reprojection error in pixels before the calibration was refined.
    after_px: float
    camera_tag: str
    detections_tag: str
    object = TaggedObject("camera_tag")
    detections = TaggedObject("detections_tag")


class MocapLeftOut(bpy.types.PropertyGroup):
    """A range of scene frames where the solve ignores one camera. Its name is the camera's name."""

    first: int
    last: int


class MocapMarker(bpy.types.PropertyGroup):
    """Data of one marker of a capture. The item's name is the marker's label."""

    meaning: str  # One of ``panels.capture.MEANINGS``.
    gaps: int
    missing_percent: float
    bone: choice("Moves With", "Bone that the marker is attached to (if unsure, keep Automatic)", _BONE_ITEMS)

    @property
    def place(self) -> str | None:
        """Marker position for a layout file: a bone, "" for no bone, or None if the user has not chosen."""
        return {"AUTO": None, "NONE": ""}.get(self.bone, f"@{self.bone}")


class MocapPointLabel(bpy.types.PropertyGroup):
    """A label that the user assigned to a point. The item's name is the label of the point's track."""

    point: int  # Column number in the recording.
    frame: int  # Frame number in the recording.
    marker: str  # Empty if the point is not one of the person's markers.


class MocapPin(bpy.types.PropertyGroup):
    """A pose that a new solve of a range must keep."""

    frame: int  # Scene frame of the pose.
    subframe: float  # Fractional offset from this frame. It can arise when the frame rate changes.
    job_values: str  # The pose as written in job files.


def _recolour(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from .viewport import colour_bones

    colour_bones(context.scene)


def _lift(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    armature = self.armature
    if armature is not None:
        armature.delta_location.z = self.floor_offset


_LIFT = {"soft_min": -0.2, "soft_max": 0.2, "precision": 4, "step": 0.1, "update": _lift}
"""Limits and update function of the floor offset, in metres."""
_FRAMES = -(2**31), 2**31 - 1  # Frame numbers that a Blender property can store.


class MocapReview(bpy.types.PropertyGroup):
    """Settings and data for reviewing the takes of one person."""

    body_tag: str
    armature = TaggedObject("body_tag", prefer_active=True)
    colours: bpy.props.BoolProperty(update=_recolour)
    below: number("Review Threshold", "List frames with a confidence below this value for review", 0.5, 0.02, 0.98)
    floor_offset: number("Floor Offset", "Raise or lower the body without adding a key", 0.0, -1e3, 1e3, "m", **_LIFT)
    first: number("First", "First scene frame to solve again", 1, *_FRAMES)
    last: number("Last", "Last scene frame to solve again", 1, *_FRAMES)
    pins: Items[MocapPin]

    def plays(self, obj: bpy.types.Object) -> bool:
        """Return whether an object is this person's body, a copy of it, or the skin of either."""
        return bool(self.body_tag) and self.body_tag in (tag_of(obj), tag_of(obj.find_armature()))

    @property
    def take(self) -> bpy.types.Action | None:
        """The take that the body plays, found in its action or in the NLA."""
        from ..animation.curves import current_action

        armature = self.armature
        action = current_action(armature) if armature is not None else None
        return action if action is not None and "motion_file" in action else None


def _show_person(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    body = self.review_of(self.person_shown).armature
    if body is not None and body.name in context.view_layer.objects and context.mode == "OBJECT":
        for other in context.selected_objects:
            other.select_set(False)
        body.select_set(True)
        context.view_layer.objects.active = body
    self.person_active = active_name(self.id_data)


class MocapPerson(bpy.types.PropertyGroup):
    """One of several people in a capture. The user can rename the person."""

    key: str  # Name in the capture file.
    frames: int  # Number of frames in which at least two cameras see this person.
    views: float  # Average number of cameras that see this person.
    review: MocapReview


def _colour_markers(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from .viewport import colour_markers

    colour_markers(context.scene)


class MocapCapture(bpy.types.PropertyGroup):
    """Data of one capture in the scene: its files, cameras, markers, people and diagnostics."""

    source: str  # Path of the recording (a file or a folder).
    file: str  # Capture file that was made from the recording.
    original: str  # Capture file with the original calibration, set if the calibration was refined.
    frames: int
    fps: float
    frame_start: int = 1
    joint_set: str
    markers: int
    marker_items: Items[MocapMarker]
    marker_index: int
    point_labels: Items[MocapPointLabel]
    label_name: choice("Label", "Marker name for the selected point, until its track ends", _NAME_ITEMS, "C7")
    subjects: str
    cloud_tag: str
    cloud = TaggedObject("cloud_tag")
    show_names: switch("Names", "Show the name next to each marker in the viewport")
    show_residuals: switch(
        "Residuals",
        "Colour markers by their distance from the solved body: green up to 10 mm, orange up to 25 mm, then red",
        on=True,
        update=_colour_markers,
    )
    cameras: Items[MocapCamera]
    network: path("Network Result", "Result of GVHMR, WHAM or another network for this video, used to estimate depth")
    show_agreement: switch("Agreement", "Outline cameras in green (good), orange (problem) or grey (not used)", on=True)
    left_out: Items[MocapLeftOut]
    checked: str  # Results of the calibration check, one per line.
    check_findings: str  # JSON text of the diagnostics of the calibration check.
    findings: str  # JSON text of the diagnostics from reading the capture.
    collection_tag: str
    floor_tag: str
    floor = TaggedObject("floor_tag")
    review: MocapReview
    people: Items[MocapPerson]
    person_shown: bpy.props.IntProperty(update=_show_person)
    person_active: str  # Name of the object that was active when the user chose a person.

    @property
    def collection(self) -> bpy.types.Collection | None:
        """The capture's collection, or None if it was deleted."""
        return find_collection(self.id_data, self.collection_tag)

    @collection.setter
    def collection(self, collection: bpy.types.Collection | None) -> None:
        self.collection_tag = give_tag(collection)

    @property
    def takes_network(self) -> bool:
        """True if a solve can use a network's result. This requires a single camera."""
        return len(self.cameras) == 1

    def refined_text(self) -> str:
        """Return the reprojection errors before and after Refine Calibration as text, or "" without refinement."""
        pairs = [(item.before_px, item.after_px) for item in self.cameras if item.after_px > 0]
        if not self.original or not pairs:
            return ""
        before, after = (sorted(column)[len(pairs) // 2] for column in zip(*pairs, strict=True))
        return f"{before:.1f} px before, {after:.1f} px after"

    def leave_out(self, scene_fps: float) -> list[str]:
        """Return the excluded cameras and their frame ranges, as the solver's ``leave_out`` setting takes them."""
        unused = [item.name for item in self.cameras if not item.use]
        ratio = self.fps / scene_fps if self.fps else 1.0
        ranges: list[str] = []
        for item in self.left_out:
            first, last = (round((frame - self.frame_start) * ratio) for frame in (item.first, item.last))
            if item.name not in unused and last >= 0 and first < self.frames and first <= last:
                ranges.append(f"{item.name}:{max(0, first)}-{last}")
        return unused + ranges

    @property
    def problems(self) -> Sequence[Diagnostic]:
        """Warnings and errors from reading the capture."""
        return warnings_in(findings_in(self.findings))

    @property
    def notes(self) -> Sequence[Diagnostic]:
        """Notes from reading the capture."""
        return notes_in(findings_in(self.findings))

    @property
    def suspect_cameras(self) -> set[str]:
        """Names of the cameras mentioned in the problems and in the results of the calibration check."""
        return {name for item in (*self.problems, *findings_in(self.check_findings)) for name in item.where.cameras}

    @property
    def measured(self) -> str:
        """File that the takes come from: the capture file, or the motion file if there is no capture."""
        return self.file or (self.source if self.review.armature is not None else "")

    def review_of(self, person: int) -> MocapReview:
        """Return the review of the person with this index, or the capture's review if it shows only one person."""
        return self.people[person].review if 0 < person < len(self.people) else self.review

    @property
    def reviews(self) -> list[MocapReview]:
        """Review data of all people in the capture."""
        return [self.review_of(person) for person in range(max(1, len(self.people)))]

    @property
    def person_index(self) -> int:
        """Index of the person with the active body, or of the person chosen last."""
        active = active_object(self.id_data)
        if active is not None and active.name_full != self.person_active:
            for person, review in enumerate(self.reviews):
                if review.plays(active):
                    return person
        return min(self.person_shown, max(0, len(self.people) - 1))

    @property
    def person(self) -> MocapPerson | None:
        """The current person, or None if the capture shows only one."""
        return self.people[self.person_index] if len(self.people) else None

    def person_named(self, key: str) -> int:
        """Return the index of the person with this name in the capture file, or 0 if there is none."""
        return next((index for index, person in enumerate(self.people) if person.key == key), 0)

    def owns(self, obj: bpy.types.Object) -> bool:
        """Return whether an object is the capture's body or skin, or belongs to the capture's collection."""
        if any(review.plays(obj) for review in self.reviews):
            return True
        collection = self.collection
        return collection is not None and collection.all_objects.get(obj.name) == obj
