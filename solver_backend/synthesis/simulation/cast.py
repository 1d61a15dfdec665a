"""Create people with random body shapes who perform a recorded motion on a level floor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks, PosedLandmarks, pose_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import NUM_BETAS, SMPL_JOINTS, JointSet

BETAS_SIGMA = 0.8  # Standard deviation of the random shapes, which keeps them within the range of most people.
FLOOR_S = 1.0  # Longest time in seconds without a sole on the floor.
TOUCH_S = 0.05  # Standard deviation in seconds of the filter that smooths the height of the skin's lowest point.
UPRIGHT = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))  # Rotation from a world with Y up to a world with Z up.


@dataclass(frozen=True)
class Take:
    """A recorded motion over F frames with Y up."""

    name: str
    rotations: np.ndarray  # (F, 22, 3, 3) local rotations of the pelvis and joints 1 to 21 relative to the T-pose.
    root: np.ndarray  # (F, 3) pelvis positions in metres.
    fps: float


@dataclass(frozen=True)
class Person:
    """The body shape and motion of a person over F frames."""

    body: Body
    betas: np.ndarray  # (10,) shape coefficients.
    orient: np.ndarray  # (F, 3, 3) rotations from body to world, Z up.
    local: np.ndarray  # (F, 21, 3, 3) local joint rotations.
    transl: np.ndarray  # (F, 3) translations in metres.

    def part(self, frames: slice | np.ndarray) -> Person:
        """Select some frames of the person's motion."""
        return Person(self.body, self.betas, self.orient[frames], self.local[frames], self.transl[frames])

    def pose(self, points: Landmarks, offsets: np.ndarray | None = None) -> PosedLandmarks:
        """Pose the body's landmarks in every frame. The offsets (L, 3) shift the landmarks in the rest pose."""
        return pose_landmarks(self.body, points, self.betas, self.orient, self.local, self.transl, offsets=offsets)

    def landmarks(self, joint_set: JointSet, offsets: np.ndarray | None = None) -> PosedLandmarks:
        """Pose the keypoints of a joint set. The offsets (K, 3) shift the keypoints in the rest pose."""
        return self.pose(keypoint_landmarks(self.body, joint_set), offsets)

    def skin(self, frames: np.ndarray) -> np.ndarray:
        """Return the (n, V, 3) skin vertices in these frames."""
        return pose_mesh(self.body, self.betas, self.orient[frames], self.local[frames], self.transl[frames])

    def on_the_floor(self, fps: float) -> Person:
        """Shift the person vertically so that a sole touches the floor at least once per second.

        The correction is the running minimum of the sole heights over ``FLOOR_S``, smoothed over the same duration.
        Ramps and stairs become flat, but shorter jumps remain.
        """
        feet = [k for k, name in enumerate(JointSet.BODY_25.keypoints) if name.endswith(("_toe", "_heel"))]
        soles = self.landmarks(JointSet.BODY_25).points[:, feet, 2].min(axis=1)
        transl = self.transl.copy()
        transl[:, 2] -= running_floor(soles, max(1, round(FLOOR_S * fps))) - 0.01
        return replace(self, transl=transl)

    def touching_the_floor(self, fps: float) -> Person:
        """Shift the person vertically so that the lowest skin point stays on the floor."""
        lowest = self.skin(np.arange(len(self.transl)))[..., 2].min(axis=1)
        reach = max(1, round(3 * TOUCH_S * fps))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (TOUCH_S * fps)) ** 2)
        floor = np.convolve(np.pad(lowest, reach, mode="edge"), kernel / kernel.sum(), mode="valid")
        return replace(self, transl=self.transl - floor[:, None] * [0.0, 0.0, 1.0])


def cast_person(
    take: Take, rng: np.random.Generator, body: Body | None = None, betas: np.ndarray | None = None
) -> Person:
    """Create a person with a random or given shape who performs a take on the floor."""
    body = body or load_body()
    if betas is None:
        betas = np.clip(BETAS_SIGMA * rng.normal(size=NUM_BETAS), -2.0, 2.0)
    rest = body.rest_joints(betas)
    legs = rest[0, 1] - rest[SMPL_JOINTS.index("left_ankle"), 1]
    recorded = float(np.percentile(take.root[:, 1], 90))
    path = (take.root - take.root[:1] * [1, 0, 1]) * (legs + 0.08) / max(recorded, 0.5)
    orient, transl = UPRIGHT @ take.rotations[:, 0], path @ UPRIGHT.T - rest[0]
    return Person(body, betas, orient, take.rotations[:, 1:], transl).on_the_floor(take.fps)


def running_floor(height: np.ndarray, frames: int) -> np.ndarray:
    """Return the smoothed minimum of (F,) heights within ``frames`` frames around each frame."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(height, frames // 2, mode="edge"), 2 * (frames // 2) + 1)
    lowest = np.pad(near.min(axis=1), 2 * frames, mode="edge")
    kernel = np.exp(-0.5 * (np.arange(-2 * frames, 2 * frames + 1) / (0.5 * frames)) ** 2)
    return np.convolve(lowest, kernel / kernel.sum(), mode="valid")


_WAVES = 24  # Number of random waves in the skin displacement.
_WAVELENGTH_M = 0.25  # Typical wavelength in metres, about the size of a calf or belly.


def strange_body(seed: int, bones: float = 0.04, flesh_mm: float = 6.0, body: Body | None = None) -> Body:
    """Create a body with proportions outside the solver's shape space.

    Every bone is stretched along its axis by a random factor, which also moves all bones below it. The skin follows
    according to its skinning weights, and is then displaced by a smooth random field. The joints are recomputed from
    the skin, so keypoints move too.

    Args:
        bones: relative standard deviation of bone lengths. Left and right bones have equal lengths.
        flesh_mm: standard deviation of the skin's displacement along each axis.
        body: body to change, or None for ours.
    """
    body, rng = body or load_body(), np.random.default_rng(seed)
    # The right side copies the left side's values. A joint's counterpart is the one nearest to its mirror image.
    mirrored = body.joints_template * [-1.0, 1.0, 1.0]
    twin = np.linalg.norm(body.joints_template[:, None] - mirrored[None], axis=-1).argmin(axis=1)
    values = rng.normal(size=len(body.parents))[np.minimum(np.arange(len(body.parents)), twin)]
    stretched = _stretched(body, bones * values)
    flesh = 1e-3 * flesh_mm * _smooth_field(body.v_template, rng)
    return replace(body, id=f"{body.id}_strange{seed}", v_template=stretched + flesh)


def _stretched(body: Body, share: np.ndarray) -> np.ndarray:
    """Return the (V, 3) skin after stretching the bone above each joint by a relative amount (J,)."""
    joints, count = body.joints_template, len(body.parents)
    moved, along, strain = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for joint, parent in enumerate(body.parents[1:], start=1):
        bone = joints[joint] - joints[parent]
        moved[joint] = moved[parent] + share[joint] * bone
        along[parent], strain[parent] = bone / np.linalg.norm(bone), share[joint]
    way = np.einsum("vjd,jd->vj", body.v_template[:, None] - joints, along) * strain
    return body.v_template + body.weights @ moved + (body.weights * way) @ along


def _smooth_field(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (N, 3) random displacements with unit variance per axis that vary smoothly between points."""
    waves = rng.normal(size=(_WAVES, 3)) * (2 * np.pi / _WAVELENGTH_M / np.sqrt(3.0))
    phases, heights = rng.uniform(0, 2 * np.pi, _WAVES), rng.normal(size=(_WAVES, 3))
    return np.sqrt(2.0 / _WAVES) * np.cos(points @ waves.T + phases) @ heights
