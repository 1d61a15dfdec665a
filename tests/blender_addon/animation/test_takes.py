"""Takes laid aside and takes offered as assets."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from blender_addon.animation.action import bake_action
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.takes import mark_as_asset, person_of, push_down
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take


def test_a_pushed_down_take_waits_on_the_nla_and_plays_again(scene: Any, take: BakedTake, files: Any) -> None:
    strip = push_down(take.armature)
    animation = take.armature.animation_data
    assert strip is not None and strip.action is take.action and animation.action is None
    assert (strip.frame_start, strip.frame_end) == (1, 60)
    track = animation.nla_tracks[take.action.name]
    assert track.mute
    track.mute = False
    np.testing.assert_allclose(evaluated_joints(scene, take.armature, 31), files.motion.joints[30], atol=1e-4)
    assert push_down(take.armature) is None
    rest = files.body.rest_joints(files.motion.betas)[0]
    again = bake_action("second", files.motion, take.armature, rest, take.timing)
    assert animation.action is again and len(animation.nla_tracks) == 1 and take.action.use_fake_user


def test_a_take_becomes_an_asset(scene: Any, files: Any) -> None:
    take = bake_take(scene, files.motion, files.body, settings=BakeSettings(asset=True))
    assert take.action.asset_data.description == "Solved take: 60 frames, solved at 30 fps"
    assert {tag.name for tag in take.action.asset_data.tags} == {"motion capture", "take"}
    mark_as_asset(take.action)
    assert len(take.action.asset_data.tags) == 2
    assert bpy.data.actions[take.action.name].use_fake_user


def test_a_provenance_that_is_no_record_names_nobody() -> None:
    for provenance in ("", "[" * 200_000, '{"person": 3}', '["person"]', "{"):
        assert person_of(provenance) == ""
    assert person_of('{"person": "Ann"}') == "Ann"
