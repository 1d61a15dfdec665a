"""Retarget live poses to a character one at a time, without actions or keys."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from .._exchange.finger_joints import FIRST_FINGER
from .._exchange.rigs.skeleton import FINGERS, SIDES, is_of_a_finger
from ..animation.takes import push_down
from ..body.body_file import BodyFile, turns_on
from ..conventions.skeleton import SMPL
from .hanging import set_switches
from .motion.figures import actor_of_poses, body_at_rest
from .motion.map_pose import map_pose, measure_proportions, scale_of
from .motion.transfer import Transferred, transfer
from .retarget import Channel, RetargetSettings, channels_of, measure_deviation_mm
from .rig_map import RigMap
from .target_rig import read_target

_BONES = 3  # Bones in each finger of the add-on's body.


class LiveRig:
    """A character's rig that follows live poses. It is looked up again after an undo."""

    def __init__(
        self,
        armature: bpy.types.Object,
        scene: bpy.types.Scene,
        rig_map: RigMap,
        settings: RetargetSettings,
        body: BodyFile,
        betas: np.ndarray,
    ) -> None:
        """Read a rig, move its action to a muted NLA track, and set its FK/IK switches as for a retarget."""
        hands = {f"{side}_{finger}_{k + 1}" for side in SIDES for finger in FINGERS for k in range(_BONES)}
        rig = read_target(armature, scene, rig_map, settings.limbs, hands if body.layout is not SMPL else ())
        self.notes = (*rig_map.doubts, *rig.notes)
        """Warnings about the map and about roles that cannot be animated, one sentence each."""
        self._target, self._modes, self._given, self._body = rig.target, rig.modes, rig_map.map_pose, body
        roles = zip(rig.target.names, rig.target.roles, strict=True)
        self._fingers = {name for name, role in roles if is_of_a_finger(role)}
        self._moves_fingers = False
        self._name, self._settings = armature.name, settings.transfer
        self.reshape(betas)
        upright = np.zeros((body.layout.num_joints, 3))
        upright[0, 0] = np.pi / 2
        done, channels = self._carried(upright, self._own.standing[0] - self._own.joints[0])
        measure_deviation_mm(rig, scene, done, channels)
        push_down(armature)
        set_switches(armature, rig.switches)

    def reshape(self, betas: np.ndarray) -> None:
        """Set a new (10,) shape of the live person. Raise ``TargetUnsuitable`` if the rig's size is not plausible."""
        self._own = body_at_rest(self._body, betas)
        still = np.zeros((1, self._body.layout.num_joints, 3))
        actor = actor_of_poses("", self._own, still, np.zeros((1, 3)), 1.0)
        scale = self._settings.scale or scale_of(measure_proportions(actor, self._target))
        self._way = replace(self._settings, scale=scale, hold_contacts=False)
        self._A = map_pose(self._target, actor.rest, self._given)

    def pose(self, rotvec: np.ndarray, transl: np.ndarray) -> bool:
        """Pose the rig from axis-angle vectors and a translation in metres. Return False if the rig is gone."""
        armature = bpy.data.objects.get(self._name)
        if armature is None or armature.pose is None or not set(self._target.names) <= set(armature.pose.bones.keys()):
            return False
        turns = turns_on(self._body.layout, rotvec[None])[0]
        self._moves_fingers |= len(self._fingers) > 0 and bool(turns[FIRST_FINGER:].any())
        _, channels = self._carried(turns, transl)
        for channel in channels:
            setattr(armature.pose.bones[channel.bone], channel.prop, channel.values[0].tolist())
        return True

    def _carried(self, rotvec: np.ndarray, transl: np.ndarray) -> tuple[Transferred, list[Channel]]:
        actor = actor_of_poses("", self._own, rotvec[None], transl[None], 1.0, still_fingers=self._moves_fingers)
        done = transfer(actor, self._target, self._A, self._way)
        channels = channels_of(done, self._target, self._modes)
        return done, [c for c in channels if self._moves_fingers or c.bone not in self._fingers]
