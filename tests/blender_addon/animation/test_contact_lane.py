"""Contacts of body parts: a lane on their bones, and edits that the next solve of a range receives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon.animation.curves import action_curves, current_action, played_target
from blender_addon.animation.lanes import contact_edits, edit_contact
from blender_addon.review.ranges import SceneRange, resolve_of
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from solver_backend.exchange.contact_parts import CONTACT_PARTS
from solver_backend.fitters.keyframes.frame_range import FrameRange

FROM = 12


@pytest.fixture
def kneeling(scene: Any, files: Any) -> BakedTake:
    touches = np.zeros((files.motion.num_frames, len(CONTACT_PARTS)), dtype=bool)
    touches[FROM:, list(CONTACT_PARTS).index("left_knee")] = True
    return bake_take(scene, replace(files.motion, touches=touches), files.body, files.capture, BakeSettings())


def lane(armature: Any, bone: str, at: list[int]) -> list[float]:
    action = current_action(armature)
    [curve] = [c for c in action_curves(action) if c.data_path == f'pose.bones["{bone}"]["contact"]']
    return [curve.evaluate(action.frame_range[0] + k) for k in at]


def test_the_lane_shows_the_parts_that_touch(kneeling: BakedTake) -> None:
    assert lane(kneeling.armature, "left_knee", [0, FROM - 1, FROM, FROM + 3]) == [0.0, 0.0, 1.0, 1.0]
    assert "contact" not in kneeling.armature.pose.bones["right_knee"]


def test_edits_are_shown_and_reach_the_job(kneeling: BakedTake, tmp_path: Path) -> None:
    armature, action = kneeling.armature, current_action(kneeling.armature)
    start, target = int(action.frame_range[0]), played_target(kneeling.armature)
    assert target is not None
    edit_contact(target, armature, "left_knee", (start + 14, start + 16), ["left_knee", 14, 16, False])
    edit_contact(target, armature, "head", (start + 2, start + 20), ["head", 2, 20, True])
    assert lane(armature, "left_knee", [13, 14, 16, 17]) == [1.0, 0.0, 0.0, 1.0]
    assert lane(armature, "neck", [1, 2, 20]) == [0.0, 1.0, 1.0]
    assert contact_edits(action) == [["left_knee", 14, 16, False], ["head", 2, 20, True]]
    (tmp_path / "walk.npz").write_bytes(b"")
    action["motion_file"] = str(tmp_path / "walk.npz")
    job = resolve_of(SceneRange(action, start + 5, start + 15))
    found = FrameRange.from_dict({"first": job.first, "last": job.last, "contacts": [vars(c) for c in job.contacts]})
    assert [(c.part, c.first, c.last, c.touches) for c in found.contacts] == [
        ("left_knee", 14, 15, False), ("head", 5, 15, True),
    ]  # fmt: skip
