"""The scene of a shot for Blender: which of the body's vertices clothes lie over, what stands in the room."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.body_layout import FAMILY
from solver_backend.exchange.npz import write_npz
from solver_backend.synthesis.studio.scene.costume import LABELS
from solver_backend.synthesis.studio.stage import Stage

FORMAT, VERSION = "manifold_mocap_studio_scene", 1


def write_scene(path: Path, stage: Stage) -> Path:
    """Write the parts of a scene that do not move; motion and cameras are in the motion and the capture file."""
    costume, room = stage.costume, stage.room
    return write_npz(
        path,
        {
            "format": np.array(FORMAT), "version": np.array(VERSION), "base": costume.base.astype(np.int32),
            "offset_m": costume.offset_m.astype(np.float32), "faces": costume.faces.astype(np.int32),
            "label": costume.label, "labels": np.array(LABELS), "outfit": np.array(stage.outfit),
            "rest": stage.person.body.v_template[costume.base].astype(np.float32),
            "room": np.stack([room.low, room.high]), "walls": np.array(room.walls), "furniture": room.furniture,
        },
    )  # fmt: skip


def write_body(path: Path, body: Body) -> Path:
    """Write a body that is not the one that ships, as ``load_body`` reads it; joints outside SMPL's by their names."""
    layout = body.layout
    known = FAMILY.get(layout.num_joints)
    own = known is None or known.joints != layout.joints
    joints = {"joint_names": np.array(layout.joints), "joint_groups": np.array(layout.groups)} if own else {}
    return write_npz(
        path,
        joints
        | {
            "v_template": body.v_template.astype(np.float32), "shapedirs": body.shapedirs.astype(np.float32),
            "posedirs": body.posedirs.astype(np.float32), "J_regressor": body.J_regressor.astype(np.float32),
            "weights": body.weights.astype(np.float32), "f": body.faces.astype(np.int32),
            "kintree_table": np.stack([layout.parents, np.arange(layout.num_joints)]), "body_id": np.array(body.id),
        },
    )  # fmt: skip
