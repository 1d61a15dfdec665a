"""A capture that is read again: what is there takes over the new cameras, detections and floor, and stays itself."""

from __future__ import annotations

from dataclasses import replace

import bpy

from ..conventions.node_inputs import get_input, set_input
from .capture_stage import CaptureStage
from .footage_timing import FOOTAGE_RATE
from .point_player import MODIFIER, RADIUS, player_of


def replace_stage(
    scene: bpy.types.Scene, stage: CaptureStage, former: list[bpy.types.Object | None], collection: bpy.types.Collection
) -> CaptureStage:
    """Return the stage of objects that were there, which show what a new stage shows; the new ones go.

    Names, parents, visibility and whatever else the user did to an object stay; what was deleted comes anew.

    Args:
        scene: the scene.
        stage: the new stage, in a collection of its own, which goes.
        former: what was there, in the order of the stage's cameras, overlays and floor; None for what was not.
        collection: of the former stage.
    """
    new = [*stage.cameras, *stage.overlays, stage.floor]
    kept = [_kept(scene, old, obj, collection) for old, obj in zip(former, new, strict=True)]
    for child in stage.collection.children:
        bpy.data.collections.remove(child)
    bpy.data.collections.remove(stage.collection)
    count = len(stage.cameras)
    return replace(
        stage, collection=collection, cameras=tuple(kept[:count]), overlays=tuple(kept[count:-1]), floor=kept[-1]
    )


def _kept(
    scene: bpy.types.Scene, old: bpy.types.Object | None, new: bpy.types.Object, collection: bpy.types.Collection
) -> bpy.types.Object:
    """Return the object that stays: the old one with the new one's contents, or the new one moved to its place."""
    if old is None:
        for home in tuple(new.users_collection):
            home.objects.unlink(new)
        collection.objects.link(new)
        return new
    data, old.data = old.data, new.data
    if old.type == "CAMERA":
        _take_view(old, data)
        old.matrix_world = new.matrix_world
    elif player_of(new) is not None:
        for key, value in new.items():
            old[key] = value
        old.modifiers[MODIFIER].node_group = player_of(new)
        set_input(old.modifiers[MODIFIER], RADIUS, get_input(new.modifiers[MODIFIER], RADIUS))
        old.parent = old.parent or new.parent  # a camera that was deleted left its detections behind
    for child in new.children:
        child.parent = old
    if scene.camera == new:
        scene.camera = old
    bpy.data.objects.remove(new)
    if data.users == 0:
        bpy.data.batch_remove((data,))
    return old


def _take_view(camera: bpy.types.Object, former: bpy.types.Camera) -> None:
    """Keep how the user saw through a camera: its footage's opacity and its size."""
    camera.data.display_size = former.display_size
    if FOOTAGE_RATE in camera.data and former.background_images:
        camera.data.background_images[0].alpha = former.background_images[0].alpha
        camera.data.show_background_images = former.show_background_images
