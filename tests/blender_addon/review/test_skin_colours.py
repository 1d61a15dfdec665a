"""The skin's colours follow the joints that lead it, and doubtful stretches of a take are found for the timeline."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from blender_addon.animation.curves import create_action, key_type_values, write_curves
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.review.ranges import colours, doubtful_bands, joint_weights, skin_colours
from blender_addon.scene.bake import BakedTake


def test_weights_of_a_vertex_are_shares_of_its_joints(take: BakedTake, files: Any) -> None:
    weights = joint_weights(take.mesh, JOINTS)
    assert weights.shape == (len(take.mesh.data.vertices), 24)
    assert np.allclose(weights.sum(axis=1), 1.0)
    assert np.abs(weights - files.body.weights / files.body.weights.sum(axis=1, keepdims=True)).max() < 1e-3


def test_skin_around_a_doubtful_joint_is_red_and_elsewhere_green(take: BakedTake) -> None:
    weights = joint_weights(take.mesh, JOINTS)
    found = skin_colours(weights, JOINTS, {"left_wrist": 0.0})
    at_wrist, away = weights[:, JOINTS.index("left_wrist")] > 0.99, weights[:, JOINTS.index("left_wrist")] == 0.0
    assert at_wrist.any() and np.allclose(found[at_wrist], colours(0.0)) and np.allclose(found[away], colours(1.0))


def test_doubtful_frames_are_bands_and_bridged_ones_red(take: BakedTake) -> None:
    target, frames = create_action("lane", take.armature), np.arange(1.0, 61.0)
    lane = np.full(60, 0.95)
    lane[9:14], lane[29:31] = 0.4, 0.0
    write_curves(target, '["confidence"]', "Confidence", frames, lane[:, None], key_type_values(None, 60))
    bands = doubtful_bands(target.action, 0.5)
    assert [(first, last) for first, last, _ in bands] == [(10.0, 14.0), (30.0, 31.0), (30.0, 31.0)]
    assert np.allclose(bands[-1][2], colours(0.0)) and not np.allclose(bands[0][2], bands[-1][2])
    assert doubtful_bands(bpy.data.actions.new("without a lane"), 0.5) == []
