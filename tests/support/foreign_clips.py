"""Real clips of other programs, as skeletons for `motion convert`: BVH files, CMU's takes, a CC0 library's GLB."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solver_backend.body.kinematics import PosedSkeleton
from solver_backend.exchange.skeleton_file import SkeletonFile, write_skeleton
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import JointSet
from tests.support.bvh_texts import Y_UP, KnownMotion, write_bvh

_LIBRARY = "mesh2motion_cc0/app_fork_glb/static/animations/human-base-animations.glb"


def cmu_take(path: Path) -> KnownMotion:
    """Read a take of ``motion_cmu``: its joints with their zero pose at rest, Z up."""
    with np.load(path) as clip:
        names, parents = tuple(str(name) for name in clip["names"]), tuple(int(p) for p in clip["parents"])
        offsets, rotvec = clip["offsets"].astype(float), clip["rotvec"].astype(float)
        root, fps = clip["root"].astype(float), float(clip["fps"])
        if "root_rotvec" in clip:
            rotvec[:, 0] = clip["root_rotvec"]
    local = exp_so3(rotvec)
    G, joints, rest = np.empty_like(local), np.empty((*local.shape[:2], 3)), np.zeros((len(names), 3))
    for j, parent in enumerate(parents):
        if parent < 0:
            G[:, j], joints[:, j] = Y_UP.T @ local[:, j], root @ Y_UP
        else:
            G[:, j] = G[:, parent] @ local[:, j]
            joints[:, j] = joints[:, parent] + G[:, parent] @ offsets[j]
            rest[j] = rest[parent] + offsets[j]
    return KnownMotion(PosedSkeleton(G, joints), rest, parents, names, fps)


_PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_LIMBS = (
    ("l", "r", ("humerus", "radius", "wrist", "femur", "tibia", "foot")),
    ("Left", "Right", ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")),
    ("l", "r", ("Shldr", "ForeArm", "Hand", "Thigh", "Shin", "Foot")),
)
"""How the skeletons of CMU's takes call their sides, and the joint at each of these parts."""


def cmu_limbs(path: Path) -> tuple[np.ndarray, float]:
    """Return (F, 17, 3) of COCO's points, Z up, of a take of ``motion_cmu``, NaN for the face; and its rate."""
    take, names = cmu_take(path), JointSet.COCO_17.keypoints
    left, right, joints = next(limbs for limbs in _LIMBS if limbs[0] + limbs[2][0] in take.names)
    points = np.full((len(take.posed.joints), len(names), 3), np.nan)
    for part, joint in zip(_PARTS, joints, strict=True):
        for side, prefix in (("left", left), ("right", right)):
            points[:, names.index(f"{side}_{part}")] = take.posed.joints[:, take.names.index(prefix + joint)]
    return points, take.fps


_MARKERS = {
    "shoulder": ("SHO",), "elbow": ("ELB",), "wrist": ("WRA", "WRB"), "hip": ("ASI", "PSI"), "knee": ("KNE",),
    "ankle": ("ANK",),
}  # fmt: skip
"""Of each landmark the markers of Plug-in Gait around it, after the side's letter."""


def ui_prmd_limbs(path: Path) -> tuple[np.ndarray, float]:
    """Return (F, 17, 3) of COCO's points, Z up, near the markers of a clip of UI-PRMD; and its rate."""
    with np.load(path) as clip:
        labels, positions = [str(label) for label in clip["labels"]], 1e-4 * clip["positions_01mm"].astype(float)
        fps = float(clip["fps"])
    points = np.full((len(positions), len(JointSet.COCO_17.keypoints), 3), np.nan)
    for part, markers in _MARKERS.items():
        for side in ("left", "right"):
            columns = [labels.index(side[0].upper() + marker) for marker in markers]
            points[:, JointSet.COCO_17.keypoints.index(f"{side}_{part}")] = positions[:, columns].mean(axis=1)
    return points, fps


def write_cmu_skeleton(path: Path, take: KnownMotion) -> Path:
    """Write a take as the file that Blender hands to ``motion convert``."""
    posed = take.posed
    write_skeleton(
        path, SkeletonFile(path.stem, take.names, take.parents, take.rest, posed.joints, posed.G, take.fps, {})
    )
    return path


def bvh_files(shared_data: Path, folder: Path, count: int) -> list[Path]:
    """Return real BVH files: those of several frames, CMU's takes written as BVH, and poses of one frame.

    Args:
        shared_data: the folder of recordings.
        folder: where takes are written.
        count: how many files are wanted.
    """
    moving = [*sorted((shared_data / "bvh_samples").glob("*.bvh")),
              *sorted((shared_data / "poses_makehuman_cc0").glob("*bvhs*.bvh"))]  # fmt: skip
    takes = sorted((shared_data / "motion_cmu" / "asfamc").glob("*.npz"))[5::23]
    written = [write_bvh(folder / f"{take.stem}.bvh", cmu_take(take), unit=0.0254) for take in takes]
    poses = sorted((shared_data / "makehuman_assets_cc0" / "base" / "poses").glob("f*.bvh"))
    return [*moving, *written, *poses][:count]


def cmu_files(shared_data: Path, folder: Path, count: int) -> list[Path]:
    """Return takes of as many subjects as there are, written as the skeletons that Blender hands on."""
    takes = sorted((shared_data / "motion_cmu" / "asfamc").glob("*.npz"))[::11][:count]
    return [write_cmu_skeleton(folder / take.name, cmu_take(take)) for take in takes]


def library_files(shared_data: Path, folder: Path, count: int) -> Iterator[Path]:
    """Write clips of the CC0 library by way of Blender, as ``motion convert`` of the add-on does it."""
    from blender_addon.retarget.recognition import open_scene
    from blender_addon.retarget.rig_actor import chosen_actor, clips_of, play_action, skeleton_of_rig

    with tarfile.open(shared_data / "mesh2motion_cc0.tar.xz") as archive:
        archive.extract(_LIBRARY, folder, filter="data")
    scene = open_scene(folder / _LIBRARY)
    rig = chosen_actor(scene, "", _LIBRARY)
    actions = [action.name for action in clips_of(rig)]
    for name in actions[:: len(actions) // count][:count]:
        play_action(rig, name)
        write_skeleton(folder / f"{name}.npz", skeleton_of_rig(rig, scene))
        yield folder / f"{name}.npz"
