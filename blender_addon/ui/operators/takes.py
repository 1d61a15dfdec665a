"""Operators that show, delete, thin, layer and resample a body's takes."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import bpy

from ...conventions.file_paths import absolute
from ...conventions.naming import counted
from ...errors import TakeMissing
from ..layout import redraw
from ..project_files import relink
from ..setting_properties import choice, number, path
from ..viewport import colour_markers, ghost_of, ghosts
from .base import BODY, EDITABLE, INTERNAL, TAKE, Call, Need, Steps, operator, options, works_here

_NOT_ON_NLA = Need(
    "The take is already on the NLA",
    lambda context: context.scene.mocap.review.armature.animation_data.action == context.scene.mocap.review.take,
)


@operator("Show Take", BODY, EDITABLE, name=str)
def show_take(self: Any, context: bpy.types.Context) -> str:
    """Play this take on the body, and keep your own action on a muted NLA track."""
    from ...animation.layers import aside_note, playing_actions
    from ...animation.takes import show_take
    from ...conventions.timing import show_frame

    scene, settings = context.scene, context.scene.mocap
    armature = settings.review.armature
    played = playing_actions(armature)
    show_take(armature, take_named(settings, self.name))
    colour_markers(scene)
    show_frame(scene)
    return aside_note(armature, played)


@operator("Show as Ghost", TAKE, options=INTERNAL, name=str)
def ghost_take(self: Any, context: bpy.types.Context) -> str:
    """Show this take as a translucent body for comparison, or remove that body."""
    from ...review.ghost import make_ghost

    settings = context.scene.mocap
    shown, take = ghost_of(settings.review), take_named(settings, self.name)
    ghosts.clear()
    if shown is None or shown.take != take.session_uid:
        ghosts.append(make_ghost(context.scene, settings.review.armature, take))
    redraw("WINDOW", "UI")
    return f"'{take.name}' is shown as a ghost" if ghosts else ""


def _confirm(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    return context.window_manager.invoke_confirm(self, event)


@operator("Delete Take", BODY, EDITABLE, invoke=_confirm, name=str)
def delete_take(self: Any, context: bpy.types.Context) -> None:
    """Delete this take from the .blend file, and keep the solver's files on the disk."""
    from ...animation.takes import show_take
    from ...conventions.timing import show_frame

    settings = context.scene.mocap
    take, review = take_named(settings, self.name), settings.review
    if not take.is_editable:
        raise TakeMissing(f"The take '{self.name}' is linked from another file. Delete it there.")
    others = [other for other in takes_of_person(settings) if other != take]
    if review.take == take and others:
        show_take(review.armature, others[-1])
    bpy.data.actions.remove(take)
    colour_markers(context.scene)
    show_frame(context.scene)


def _choose_folder(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    context.window_manager.fileselect_add(self)
    return {"RUNNING_MODAL"}


_PLACE = path("Folder", "Folder that now contains the files", folder=True)


@operator("Relink Moved Files", invoke=_choose_folder, directory=_PLACE)
def relink_files(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Choose the new folder of moved captures and takes, and link the files with the same names."""
    changed, missing = relink(absolute(self.directory))
    if not changed:
        return self.give_up(f"The folder has no {missing[0].name}, or several" if missing else "No file is missing")
    still = f". Still missing: {', '.join(path.name for path in missing)}" if missing else ""
    return self.finish(f"Relinked {counted(changed, 'file')}{still}", warn=missing)


def takes_of_person(settings: bpy.types.PropertyGroup) -> list[bpy.types.Action]:
    """Return the current person's takes in the current capture."""
    from ...animation.takes import takes_of

    capture = settings.capture
    return takes_of(capture.measured, capture.person.key if capture.person else "", capture.original)


def take_named(settings: bpy.types.PropertyGroup, name: str) -> bpy.types.Action:
    """Return the current person's take with this name. Raise ``TakeMissing`` if there is none."""
    action = next((take for take in takes_of_person(settings) if take.name == name), None)
    if action is None:
        raise TakeMissing(f"This capture has no take '{name}' for this person.")
    return action


def _draw_limit(self: Any, context: bpy.types.Context) -> None:
    self.layout.prop(self, "by", expand=True)
    self.layout.prop(self, "tolerance_mm" if self.by == "TOLERANCE" else "keys_per_second")


# Options for thinning a take, with their defaults and limits.
_THINNING: dict[str, Any] = {
    "by": choice("Keep by", "Rule that decides how many keys remain", "thin_take.by", "TOLERANCE"),
    "tolerance_mm": number("Tolerance", "Maximum distance of a joint from the full take, in mm", 10.0, 0.5, 500),
    "keys_per_second": number("Keys per Second", "Average density of the remaining keys", 10.0, 0.1, 30),
}


def edit_aside(
    context: bpy.types.Context, switch: Sequence[str] = (), **limit: float
) -> Generator[Call, Any, dict[str, Any]]:
    """Edit a copy of the current take in a second Blender, and play the new action.

    ``switch`` is empty, or IK or FK followed by the limbs to switch. A switch replaces the keys of the take itself,
    unless the user has changed them in the meantime. ``limit`` contains the options for key reduction. The result has
    no action if there was nothing to edit.
    """
    from tempfile import TemporaryDirectory

    from ...animation.curves import keys_of
    from ...animation.lanes import CONTACT
    from ...animation.takes import PATHS, show_take, take_file
    from ...body.controls.limbs import limb_of
    from ...body.shape import body_mesh
    from ...conventions.timing import show_frame
    from ...scene.limb_modes import take_switched
    from ...scene.session import save_alone

    scene, review = context.scene, context.scene.mocap.review
    body, take = review.armature.session_uid, review.take.session_uid  # the user may rename both in the meantime
    with TemporaryDirectory() as folder:
        source, out = Path(folder, "take.blend"), Path(folder, "edited.blend")
        files = {key: str(take_file(review.take, key)) for key in PATHS if review.take.get(key)}
        mesh = body_mesh(review.armature)  # the feet are kept on the floor by the soles of the skin
        save_alone(source, review.armature, [mesh] if mesh else [], scene, files=files, switch=[*switch])
        lane = f'["{CONTACT}"]'  # the user may edit this lane in the meantime
        keys = keys_of(review.take, lane)
        words = [str(source), f"--armature={review.armature.name}", "--own", *options(out=out, **limit)]
        result: Any = yield Call("edit", words, Path(folder), through_blender=True, solves=False)
        armature = next((obj for obj in bpy.data.objects if obj.session_uid == body), None)
        former = next((action for action in bpy.data.actions if action.session_uid == take), None)
        if armature is None or former is None:
            raise TakeMissing(
                "The body or its take was removed while the edit ran.", hint="Undo the deletion, and try again."
            )
        if result["action"]:
            with bpy.data.libraries.load(str(out)) as (_, wanted):
                wanted.actions = [result["action"]]
            [action] = wanted.actions
            if switch:
                to, *limbs = switch
                if is_same := keys_of(former, lane) == keys:
                    take_switched(armature, former, action, to, [limb_of(name) for name in limbs])
                bpy.data.actions.remove(action)
                action = former if is_same else None
            else:
                for key in PATHS:
                    if key in former:
                        action[key] = former[key]
                show_take(armature, action)
            show_frame(context.scene)
            result["action"] = action
        return result


@operator("Reduce Keys", TAKE, EDITABLE, waits=False, draw=_draw_limit, **_THINNING)
def thin_take(self: Any, context: bpy.types.Context) -> Steps:
    """Add a take with fewer keys that includes your edits, and report its deviation from this take."""
    from ...scene.bake import thinned_take

    review = context.scene.mocap.review
    by_tolerance = self.by == "TOLERANCE"
    if works_here([review.armature], review.take["frames"]):
        limits = (None, self.tolerance_mm) if by_tolerance else (self.keys_per_second, None)
        return thinned_take(context.scene, review.take, review.armature, *limits)["keys_deviation"]
    limit = {"keys_within": self.tolerance_mm} if by_tolerance else {"keys_per_second": self.keys_per_second}
    made = yield from edit_aside(context, **limit)
    return made["action"]["keys_deviation"]


@operator("Push Down to NLA", TAKE, EDITABLE, _NOT_ON_NLA)
def push_down(self: Any, context: bpy.types.Context) -> str:
    """Move this take to an NLA track of the same name, which the body then plays."""
    from ...animation.takes import push_down

    review = context.scene.mocap.review
    armature, name = review.armature, review.take.name
    push_down(armature)
    armature.animation_data.nla_tracks[-1].mute = False
    return f"'{name}' plays from an NLA track with its name"


@operator("Edit on a Layer", TAKE, EDITABLE)
def edit_on_layer(self: Any, context: bpy.types.Context) -> str:
    """Add an empty action on top of the take for your edits, so that the take's own keys are kept."""
    from ...animation.layers import add_layer

    review = context.scene.mocap.review
    take = review.take
    layer = add_layer(review.armature, take)
    return f"Your keys are added to '{layer.name}', on top of '{take.name}'"


@operator("Follow Frame Rate")
def follow_rate(self: Any, context: bpy.types.Context) -> str:
    """Resample takes, detections, footage, confidence and pins to the scene's frame rate."""
    from ...conventions.timing import scene_frame_rate, show_frame
    from ...scene.frame_rate import relay

    scene = context.scene
    ratio = relay(scene, takes_of_captures(scene))
    for capture in scene.mocap.captures:
        start = capture.frame_start
        for item in (*capture.left_out, *capture.reviews):
            item.first, item.last = (round(start + (f - start) * ratio) for f in (item.first, item.last))
        for pin in (pin for review in capture.reviews for pin in review.pins):
            exact = start + (pin.frame + pin.subframe - start) * ratio
            pin.frame, pin.subframe = round(exact), exact - round(exact)
    show_frame(scene)
    return f"Everything was resampled to {scene_frame_rate(scene):g} fps"


def takes_of_captures(scene: bpy.types.Scene) -> list[bpy.types.Action]:
    """Return the takes of all captures in a scene."""
    from ...animation.curves import is_take
    from ...animation.takes import takes_of

    found = [takes_of(capture.measured, original=capture.original) for capture in scene.mocap.captures]
    return [action for actions in found for action in actions if is_take(action)]
