"""The actor of a motion file: our body, with its fingers where the motion has them."""

from __future__ import annotations

from ..._exchange.motion_file import MotionFile
from ...body.body_file import BodyFile
from ...body.posed_body import pose_joints, rotvec_on, with_own_hands
from ...conventions.coordinates import R_ARMATURE_BODY
from ...conventions.skeleton import SMPL
from .figures import Actor
from .fingers import hands_of_body


def actor_of_motion(motion: MotionFile, body: BodyFile) -> Actor:
    """Return the actor of a motion file.

    Args:
        motion: the motion.
        body: the body it was solved for.
    """
    soles = (body.shaped(motion.betas) @ R_ARMATURE_BODY.T)[:, 2].min()
    rest = body.rest_joints(motion.betas)
    motion = with_own_hands(motion, body)
    G, joints = pose_joints(rest, rotvec_on(motion, body.layout), motion.transl)
    standing, turns = rest @ R_ARMATURE_BODY.T - [0.0, 0.0, soles], G @ R_ARMATURE_BODY.T
    own = list(body.layout.standing_for(SMPL))
    has_fingers = len(motion.body_layout.joints) > SMPL.num_joints
    hands = hands_of_body(body.layout, standing, turns) if has_fingers else ()
    return Actor(motion.name, standing[own], turns[:, own], joints[:, own], motion.fps, motion.contacts, hands=hands)
