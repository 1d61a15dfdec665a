"""Clocks by the speeds of keypoints, without calibration: a detector sees somebody who stands and claps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.filming import FilmSettings, around, film
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.faults import MEASURED_DETECTOR
from solver_backend.synthesis.simulation.cast import Take, cast_person
from solver_backend.types import SMPL_JOINTS, JointSet
from solver_backend.videos.sync.clocks import SyncUnknown
from solver_backend.videos.sync.synchronise import synchronise
from solver_backend.videos.video_detections import VideoDetections

FPS, FRAMES, MARGIN = 60.0, 480, 100
JOINT_SET = JointSet.BODY_25
CLAPS_S = (3.4, 3.9, 4.7)
NAMES = ("a", "b", "c", "d")
OPEN, CLOSED = np.radians([55.0, 107.0])
"""How far arms are turned forwards from the sides: hands apart, and palms together."""
APPROACH_S, BLEND_S = 0.14, 0.25


def standing() -> Take:
    """Return somebody who stands with arms hanging and sways a little, Y up."""
    rotations = np.tile(np.eye(3), (FRAMES, 22, 1, 1))
    sway = 0.02 * np.sin(np.arange(FRAMES) / 40.0)[:, None] * np.array([0.0, 0.0, 1.0])
    rotations[:, 0] = exp_so3(sway)
    for joint, sign in ((16, -1.0), (17, 1.0)):
        rotations[:, joint] = exp_so3(np.array([0.0, 0.0, sign * 1.2]))
    return Take("standing", rotations, np.tile([0.0, 0.95, 0.0], (FRAMES, 1)), FPS)


def clapping(take: Take, at_s: tuple[float, ...]) -> Take:
    """Return the take with claps at these times: arms level, hands rush together, meet, and part as fast."""
    times = np.arange(len(take.rotations)) / take.fps
    since = np.min([np.abs(times - t) for t in at_s], axis=0)
    # The speed does not vanish where palms meet: it turns.
    turned = OPEN + (CLOSED - OPEN) * np.clip(1.0 - since / APPROACH_S, 0.0, 1.0) ** 1.2
    lifted = np.clip((min(at_s) - times) / BLEND_S, 0.0, None) + np.clip((times - max(at_s)) / BLEND_S, 0.0, None)
    share = np.clip(2.0 - lifted, 0.0, 1.0)[:, None, None]
    rotations = take.rotations.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        joint = SMPL_JOINTS.index(f"{side}_shoulder")
        rotations[:, joint] = _nearest(
            (1 - share) * rotations[:, joint] + share * exp_so3(sign * turned[:, None] * np.array([0.0, 1.0, 0.0]))
        )
        for still in ("collar", "elbow", "wrist"):
            joint = SMPL_JOINTS.index(f"{side}_{still}")
            rotations[:, joint] = _nearest((1 - share) * rotations[:, joint] + share * np.eye(3))
    return replace(take, rotations=rotations)


def _nearest(matrices: np.ndarray) -> np.ndarray:
    U, _, Vt = np.linalg.svd(matrices)
    U[..., -1] *= np.linalg.det(U @ Vt)[..., None]
    return U @ Vt


def filmed(take: Take, seed: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Return four views' tracks and their clocks' offsets in seconds; the detector guesses hands that are hidden."""
    rng = np.random.default_rng(seed)
    person = cast_person(take, rng)
    cameras = around(person.landmarks(JOINT_SET).skeleton.joints[:, 0], 4)
    late_s = np.r_[0.0, rng.uniform(-1.5, 1.5, 3)]
    cut = np.floor(late_s * FPS).astype(int)
    delays = np.tile((cut - late_s * FPS)[:, None], (1, FRAMES))
    model = replace(MEASURED_DETECTOR, occluded_missing=0.0)
    found = film(person, cameras, FilmSettings(JOINT_SET, FPS, model, None, delays), rng)
    return [found.xy[c, MARGIN + cut[c] : FRAMES - MARGIN + cut[c]] for c in range(4)], -late_s


def detections(tracks: list[np.ndarray]) -> list[VideoDetections]:
    return [
        VideoDetections(
            Path(f"{name}.mp4"), "h", "d", JOINT_SET, (1920, 1080), np.arange(len(track)) / FPS, track[:, None],
            np.isfinite(track[..., 0])[:, None].astype(float), np.zeros((len(track), 1), int),
        )
        for name, track in zip(NAMES, tracks, strict=False)
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_uneven_claps_of_somebody_who_stands_tell_the_clocks_to_a_frame(seed: int) -> None:
    tracks, offset_s = filmed(clapping(standing(), CLAPS_S), seed)
    told = synchronise(detections(tracks), None, "keypoints")
    assert np.abs(told.offset_s - offset_s).max() * FPS < 1.0
    assert told.method == "keypoint speeds"


def test_a_person_who_does_not_move_shows_no_clock() -> None:
    still = np.broadcast_to(np.linspace(100.0, 800.0, 50).reshape(1, 25, 2), (120, 25, 2))
    with pytest.raises(SyncUnknown, match="cannot be synchronised"):
        synchronise(detections([still, still]), None, "keypoints")
    with pytest.raises(SyncUnknown, match="only one frame"):
        synchronise(detections([still, still[:1]]), None, "keypoints")
