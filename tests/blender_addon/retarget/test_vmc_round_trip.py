"""A motion sent by the VMC protocol, recorded and retargeted plays on a rig of its proportions as it was."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import read_motion
from blender_addon.body.body_file import default_body_path, pose_joints, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import retarget
from solver_backend.body.body import load_body
from solver_backend.exchange.vmc.humanoid import Humanoid
from solver_backend.exchange.vmc.osc import FrameBundle
from solver_backend.live.recordings import PosesRecording, Recorder
from solver_backend.live.sending import rest_joints
from solver_backend.live.vmc_source import BonesOnBody, FrameAssembly, pose_lines
from solver_backend.types import Motion
from tests.support.foreign_characters import skinned_rig
from tests.support.own_skeleton import own_skeleton
from tests.support.retarget_measures import shown
from tests.support.short_motion import short_motion

BETAS = np.array([0.8, -0.5, 0.6, 0.9, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
FRAMES, FPS = 20, 30.0


def recorded(motion: Motion, path: Path) -> Path:
    """Return the recording of a motion that came as packets, from a sender of unknown shape."""
    bundle = FrameBundle(Humanoid(motion.body_layout, rest_joints(motion)))
    vectors = np.concatenate([motion.global_orient, motion.body_pose], axis=1).reshape(FRAMES, -1, 3)
    onto, assembly = BonesOnBody(load_body()), FrameAssembly()
    with Recorder(path, PosesRecording("test", onto.person), overwrite=False) as recorder:
        packets = (bundle.encode(k / FPS, vectors[k], motion.transl[k]) for k in range(FRAMES))
        frames = (frame for k, packet in enumerate(packets) for frame in assembly.take(packet, "me", k / FPS))
        assert sum("frame" in line for line in pose_lines(frames, onto, recorder)) == FRAMES
    return path


@pytest.mark.parametrize("fingers", [False, True])
def test_every_bone_is_within_a_tenth_of_a_degree_and_hands_within_a_millimetre(
    scene: bpy.types.Scene, tmp_path: Path, fingers: bool
) -> None:
    motion = short_motion(FRAMES, FPS, BETAS, fingers=fingers)
    body = read_body(default_body_path(), motion.body_layout)
    rig = skinned_rig(own_skeleton(body, BETAS))
    scene.render.fps, scene.frame_end = int(FPS), FRAMES
    read = read_motion(recorded(motion, tmp_path / "take.npz"))
    timing = TakeTiming(1, FPS)
    retarget(actor_of_motion(read, body), rig, scene, map_rig(rig), timing)
    names = list(own_skeleton(body, BETAS).roles.values())
    seen = shown(rig, names, timing.scene_frames(FRAMES, FPS))
    sent = np.concatenate([motion.global_orient, motion.body_pose], axis=1).reshape(FRAMES, -1, 3)
    G, joints = pose_joints(body.rest_joints(BETAS), sent, motion.transl)
    up = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    for j, (role, name) in enumerate(own_skeleton(body, BETAS).roles.items()):
        if role.endswith("middle_1") and not fingers:  # knuckles of flat hands are no bones of the protocol
            continue
        R = seen.turns[name] @ np.swapaxes(G[:, j] @ up, -1, -2)
        assert np.degrees(np.linalg.norm(R - np.eye(3), axis=(1, 2)) / 2**0.5).max() < 0.1, role
        assert np.linalg.norm(seen.heads[name] - joints[:, j], axis=1).max() < 1e-3, role
