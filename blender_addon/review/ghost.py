"""The ghost: the skin of a second take, drawn only in the viewport. It adds nothing to the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from ..animation.curves import play_action
from ..animation.layers import restore_place
from ..body.body_file import BodyFile, body_path_of, read_body, skin
from ..body.controls.limbs import ROOT
from ..body.looks import look_of, offsets_of
from ..body.shape import body_mesh
from ..conventions.skeleton import layout_of
from ..scene.clips import played_motion
from ..scene.hand_edits import take_times

COLOUR = np.array([0.45, 0.75, 1.0])  # Linear RGB of the ghost. Chosen by hand.
_FACING, _EDGE = 0.10, 0.75  # Opacity of skin that faces the viewer, and of skin seen edge-on. Chosen by hand.


@dataclass(frozen=True, eq=False)
class Ghost:
    """A take that is drawn over the scene, with the edits that it had when the ghost was created."""

    take: int  # Session identifier of the action.
    armature: int  # Session identifier of the body.
    times: np.ndarray  # (F,) scene frames of the take.
    motion: MotionFile  # Motion relative to the armature.
    body: BodyFile
    worn: np.ndarray | float  # (V, 3) offsets of the body's look at rest, in metres.
    world: np.ndarray  # (4, 4) world matrix of the armature at the place stored in the take.

    def skin(self, frame: float) -> np.ndarray:
        """Return vertices (V, 3) in Blender units, in the take's frame nearest to a scene frame."""
        return _skin(self, int(np.abs(self.times - frame).argmin()))


@lru_cache(maxsize=1)
def _skin(ghost: Ghost, row: int) -> np.ndarray:
    return skin(ghost.body, ghost.motion, [row], ghost.worn)[0] @ ghost.world[:3, :3].T + ghost.world[:3, 3]


def make_ghost(scene: bpy.types.Scene, armature: bpy.types.Object, take: bpy.types.Action) -> Ghost:
    """Return the ghost of a body's take, without the edit layers on top of the take.

    Raises:
        MocapError: the motion file or the body file is missing.
    """
    with _stand_in(armature, take) as double:
        root = double.pose.bones.get(ROOT)
        is_moved = root is not None and not np.allclose(root.matrix_basis, np.eye(4), atol=1e-6)
        motion = played_motion(scene, double, take, with_place=is_moved)
        world = armature.matrix_world @ armature.matrix_basis.inverted() @ double.matrix_basis
    body = read_body(body_path_of(motion.provenance), layout_of(armature.data.bones))
    mesh, numbers = body_mesh(armature), (take.session_uid, armature.session_uid)
    worn = 0.0 if mesh is None else offsets_of(body, look_of(mesh))
    return Ghost(*numbers, take_times(take, motion), motion, body, worn, np.array(world, np.float64))


@contextmanager
def _stand_in(armature: bpy.types.Object, take: bpy.types.Action) -> Iterator[bpy.types.Object]:
    """Yield a temporary copy of a body that plays nothing but this take."""
    double = armature.copy()
    try:
        animation = double.animation_data or double.animation_data_create()
        for track in list(animation.nla_tracks):
            animation.nla_tracks.remove(track)
        animation.action_blend_type, animation.action_influence = "REPLACE", 1.0
        play_action(double, take)
        restore_place(double, take)
        rules = [rule for bone in double.pose.bones for rule in bone.constraints]
        targets = [target for curve in animation.drivers for v in curve.driver.variables for target in v.targets]
        for owner in (*rules, *targets):
            for name in ("target", "pole_target", "id"):
                if getattr(owner, name, None) == armature:
                    setattr(owner, name, double)
        yield double
    finally:
        bpy.data.objects.remove(double)


def shaded(points: np.ndarray, faces: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Return vertex colours (V, 4) that are translucent, but more opaque at the silhouette.

    Args:
        faces: (T, 3) vertex indices of the triangles.
        eye: (3,) unit vector towards the viewer.
    """
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal, corners = np.repeat(np.cross(b - a, c - a), 3, axis=0), faces.ravel()
    sums = np.stack([np.bincount(corners, normal[:, k], len(points)) for k in range(3)], axis=1)
    facing = np.abs(sums @ eye) / np.maximum(np.linalg.norm(sums, axis=1), 1e-12)
    opacity = _FACING + (_EDGE - _FACING) * (1.0 - facing) ** 2
    return np.column_stack([np.tile(COLOUR, (len(points), 1)), opacity]).astype(np.float32)
