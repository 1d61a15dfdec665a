"""Sight lines in matrix products end where sight lines cast at the posed skin end, but for a few at the body's rim."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from solver_backend.cameras.projection import project
from solver_backend.synthesis.simulation.keypoint_detector import stabbed_faces
from solver_backend.synthesis.studio.sight import own_parts
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import Stage, list_shots, set_up
from solver_backend.synthesis.studio.truth import FURNITURE_HIDDEN, OUTSIDE, SELF_HIDDEN, VISIBLE, find_truth
from solver_backend.types import JointSet

SPEC: dict[str, Any] = {
    "camera_arrays": [
        {"count": 4, "radius_m": 3, "size": [640, 480], "distortion": [-0.09, 0.06, 0.0005, -0.0004, 0.0]}
    ],
    "frames": 60, "fps": 10, "looks": ["cluttered"], "seed": 3,
}  # fmt: skip


def cast(stage: Stage, skin: np.ndarray, points: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Return (C, f, K) what hides each point, told by every triangle of skin and furniture."""
    own = own_parts(stage.person.body, names)
    furniture, pieces = stage.room.furniture_mesh()
    hidden = np.zeros((len(stage.cameras), *points.shape[:2]), np.uint8)
    for view, (R, t) in enumerate(zip(stage.cameras.R, stage.cameras.t, strict=True)):
        for frame in range(len(points)):
            targets = points[frame] @ R.T + t
            face, target = stabbed_faces(skin[frame] @ R.T + t, stage.person.body.faces, targets)
            mine = np.bincount(target, ~own[target, face], minlength=len(targets)) > 0
            hidden[view, frame, mine] = SELF_HIDDEN
            hidden[view, frame, np.unique(stabbed_faces(furniture @ R.T + t, pieces, targets)[1])] = FURNITURE_HIDDEN
    return hidden


@pytest.mark.slow
@pytest.mark.parametrize(("strange", "least"), [(False, 0.965), (True, 0.955)])
def test_sight_lines_end_as_at_the_mesh(strange: bool, least: float) -> None:
    spec = spec_of(SPEC | {"people": {"count": 2, "sigma": 1.5, "strange": strange}})
    agree: list[float] = []
    kept, told, furniture = 0, 0, []
    for shot in list_shots(spec):
        stage = set_up(spec, shot)
        truth, frames = find_truth(stage, spec.fps), np.arange(0, stage.num_frames, 6)
        skin = stage.person.skin(frames)
        for joint_set in (JointSet.BODY_25, JointSet.MEDIAPIPE_33, JointSet.SMPL_24):
            points = truth.keypoints3d[joint_set][frames]
            exact = cast(stage, skin, points, joint_set.keypoints)
            found = truth.visibility[joint_set][:, frames]
            inside = found != OUTSIDE
            found = np.where(found == VISIBLE, 0, found)
            agree.append(float((found == exact)[inside].mean()))
            furniture.append(float(((found == FURNITURE_HIDDEN) == (exact == FURNITURE_HIDDEN))[inside].mean()))
            told += int(((found == SELF_HIDDEN) & (exact == SELF_HIDDEN) & inside).sum())
            kept += int(((exact == SELF_HIDDEN) & inside).sum())
    assert np.mean(agree) > least, agree
    assert min(furniture) > 0.999, "a box is a box in both"
    assert told / kept > 0.85 and kept > 100


def test_boxes_and_shares_are_those_of_the_whole_skin() -> None:
    spec = spec_of(SPEC | {"people": {"count": 2, "sigma": 1.5}})
    for shot in list_shots(spec):
        stage = set_up(spec, shot)
        truth, frames = find_truth(stage, spec.fps), np.arange(0, stage.num_frames, 6)
        c = stage.cameras
        px = project(c, stage.person.skin(frames))
        within = ((px >= -0.5) & (px < c.image_size[:, None, None] - 0.5)).all(axis=-1)
        whole = within.all(axis=2)
        exact = np.concatenate([px.min(axis=2), px.max(axis=2)], axis=-1)
        off = np.abs(truth.boxes[:, frames] - exact)[whole]
        assert whole.sum() > 10 and off.max() < 6.0 and off.mean() < 0.8, (off.max(), off.mean())
        assert np.abs(truth.inside[:, frames] - within.mean(axis=2)).max() < 0.03


def test_a_point_behind_the_body_is_hidden_and_one_before_it_is_not() -> None:
    spec = spec_of(
        SPEC | {"looks": ["bare"], "frames": 1, "camera_arrays": [{"count": 2, "turn_deg": 90, "radius_m": 3}]}
    )
    stage = set_up(spec, list_shots(spec)[0])
    ways = np.einsum("fij,cfi->cfj", stage.person.orient, (c := stage.cameras.centres)[:, None] - stage.joints[:, 0])
    names = list(JointSet.BODY_25.keypoints)
    seen = find_truth(stage, spec.fps).visibility[JointSet.BODY_25][:, 0, names.index("nose")]
    assert len(c) == 2 and [bool(v == VISIBLE) for v in seen] == [bool(z > 0) for z in ways[:, 0, 2]]
