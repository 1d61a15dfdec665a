"""Find why MakeHuman's fight02 and fly02 do not fit our body: the rotations of the collars, or their length.

``python -m tests.benchmarks.collar_lengths`` prints the root mean square distance of the limbs' joints as ``motion``
fits them, with free rotations of collars, spine and upper arms, and with collars that are longer by a factor (as an
oracle, because our body does not have such collars).
"""

from __future__ import annotations

import sys
from unittest.mock import patch

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.fitters.motion_import import import_motion
from solver_backend.fitters.motion_import.import_motion import Measured, measure, shape_from_lengths
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from tests.conftest import recordings_folder

CLIPS = ("fight02", "fly02")
FACTORS = (1.0, 1.1, 1.2, 1.3, 1.5, 2.0)
FREE_RAD = 10.0
"""Standard deviation in radians of an unconstrained rotation."""
_LIMBS = list(SMPL.both("hip", "knee", "ankle", "shoulder", "elbow", "wrist"))
_ARMS = tuple(zip(*map(SMPL.both, ("collar", "shoulder", "elbow", "wrist", "hand")), strict=True))
_TRUNK = (*SMPL.numbers("spine1", "spine2", "spine3"), *SMPL.both("shoulder"))


def main() -> int:
    """Print a table."""
    folder, body = recordings_folder() / "makehuman_assets_cc0" / "base" / "poses", load_body()
    collars = [arm[0] for arm in _ARMS]
    for name in CLIPS:
        source, roles, _ = read_foreign_clip(folder / f"{name}.bvh")
        measured = measure(source, roles, body.rest_joints(np.zeros(10))[:NUM_JOINTS])
        rest = body.rest_joints(shape_from_lengths(body, measured.rest))[:NUM_JOINTS]
        sys.stdout.write(f"{name}: collars free {free_mm(rest, measured, collars):.1f} mm, ")
        sys.stdout.write(f"spine and upper arms, too {free_mm(rest, measured, [*collars, *_TRUNK]):.1f} mm\n")
        for factor in FACTORS:
            sys.stdout.write(f"  collars x {factor:g}: {off_mm(longer(rest, factor), measured):.1f} mm\n")
    return 0


def longer(rest: np.ndarray, factor: float) -> np.ndarray:
    """Return rest joints with collars longer by a factor, and the arms moved along."""
    rest = rest.copy()
    for collar, shoulder, *below in _ARMS:
        rest[[shoulder, *below]] += (factor - 1.0) * (rest[shoulder] - rest[collar])
    return rest


def free_mm(rest: np.ndarray, measured: Measured, joints: list[int]) -> float:
    """Return the distance in millimetres with free rotations of some joints."""
    sigmas = import_motion._TURN_SIGMA.copy()
    sigmas[joints] = FREE_RAD
    with patch.object(import_motion, "_TURN_SIGMA", sigmas):
        return off_mm(rest, measured)


def off_mm(rest: np.ndarray, measured: Measured) -> float:
    """Return the root mean square distance in millimetres of the limbs' joints from the skeleton's."""
    joints = import_motion.fit_poses(rest, measured)[1][:, _LIMBS]
    return 1000.0 * float(np.sqrt(((joints - measured.places[:, _LIMBS]) ** 2).sum(-1).mean()))


if __name__ == "__main__":
    sys.exit(main())
