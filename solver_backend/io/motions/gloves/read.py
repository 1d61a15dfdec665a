"""Hands of any supported recording: tables of MANUS and Rokoko, BVH and skeleton files with fingers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.body.hand_angles import NUM_ANGLES
from solver_backend.body.skeleton_fingers import finger_angles, finger_points, hands_of_skeleton
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.hand_points import SIDES
from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.rigs.structure import recognise
from solver_backend.exchange.skeleton_file import read_skeleton
from solver_backend.io.motions.bvh import read_bvh
from solver_backend.io.motions.bvh_motion import bvh_motion, bvh_skeleton
from solver_backend.io.motions.gloves.manus_csv import is_manus_csv, read_manus_csv
from solver_backend.io.motions.gloves.rokoko_csv import is_rokoko_csv, read_rokoko_csv
from solver_backend.types import SkeletonMotion
from solver_backend.types.glove_take import GloveTake

_THROUGH_BLENDER = (".fbx", ".glb", ".gltf", ".vrm", ".blend")


def read_gloves(path: Path, side: str = "") -> GloveTake:
    """Read the hands of a recording, of a whole person or of hands alone.

    Args:
        path: CSV of MANUS or Rokoko, BVH, or a skeleton file from Blender.
        side: ``left`` or ``right`` of a single hand whose names do not show it.

    Raises:
        FileMissing, FileDamaged, NonFiniteData: the file is not there, or is none of its kind.
        MotionInvalid: it holds no fingers, or which side they are of does not show.
    """
    suffix, where = path.suffix.lower(), str(path)
    if suffix == ".csv":
        if is_manus_csv(path):
            return read_manus_csv(path, side)
        if is_rokoko_csv(path):
            return read_rokoko_csv(path)
        hint = "Tables of MANUS (joint positions or ergonomics) and Rokoko Studio are read; or export BVH or FBX."
        raise MotionInvalid("The table is not one of known gloves.", where=where, hint=hint)
    if suffix == ".bvh":
        clip = read_bvh(path, metres_per_unit=1.0)
        return gloves_of_skeleton(bvh_motion(clip, bvh_skeleton(clip, where), 1.0, path.stem), side, where)
    if suffix == ".npz":
        return gloves_of_skeleton(read_skeleton(path), side, where)
    if suffix in _THROUGH_BLENDER:
        hint = f"python -m blender_addon add-hands MOTION.npz {path.name} reads it with Blender's importer."
        raise MotionInvalid(f"{suffix[1:].upper()} is read through Blender.", where=where, hint=hint)
    raise MotionInvalid(
        f"Not supported: {suffix or 'files without an ending'}.", where=where, hint="CSV, BVH and FBX are read."
    )


def gloves_of_skeleton(motion: SkeletonMotion, side: str, where: str) -> GloveTake:
    """Return the hands of a moving skeleton.

    Args:
        motion: of a person or of hands, in any unit.
        side: ``left`` or ``right`` of a single hand whose names do not show it.
        where: for the error.

    Raises:
        MotionInvalid: no hand has four fingers of three bones, or its side is not known.
    """
    parents = {n: motion.names[p] for n, p in zip(motion.names, motion.parents, strict=True) if p >= 0}
    roles = recognise(Skeleton(dict(zip(motion.names, motion.rest, strict=True)), parents)).roles
    angles = np.full((motion.num_frames, 2, NUM_ANGLES), np.nan)
    palms = np.full((motion.num_frames, 2, 3, 3), np.nan)
    for named in (roles, hands_of_skeleton(motion, side)):
        for number in range(len(SIDES)):
            if np.isfinite(angles[:, number]).any():
                continue
            if (points := finger_points(motion, named, number)) is not None:
                angles[:, number], palms[:, number] = finger_angles(points, number)
    if not np.isfinite(angles).any():
        hint = "Thumb, index, middle and little finger of three bones each are needed; --side names a single hand."
        raise MotionInvalid("The skeleton has no hand whose fingers and side are known.", where=where, hint=hint)
    return GloveTake(motion.name, np.arange(motion.num_frames) / motion.fps, angles, palms)
