"""Create people of random shape who repeat a recorded motion on the floor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks, PosedLandmarks, pose_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import NUM_BETAS, SMPL_JOINTS, JointSet

BETAS_SIGMA = 0.8  # Standard deviation of the drawn shapes, within the range of most people.
FLOOR_S = 1.0  # Seconds within which a sole touches the floor.
TOUCH_S = 0.05  # Standard deviation in seconds of the smoothing of the skin's lowest point.
UPRIGHT = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))  # Rotation from Y up to Z up.


@dataclass(frozen=True)
class Take:
    """A recorded motion with F frames, Y up."""

    name: str
    rotations: np.ndarray  # (F, 22, 3, 3) local rotations of the pelvis and joints 1..21 relative to the T-pose.
    root: np.ndarray  # (F, 3) pelvis positions in metres.
    fps: float


@dataclass(frozen=True)
class Person:
    """A moving body in F frames."""

    body: Body
    betas: np.ndarray  # (10,) shape coefficients.
    orient: np.ndarray  # (F, 3, 3) rotations from body to world, Z up.
    local: np.ndarray  # (F, 21, 3, 3) local joint rotations.
    transl: np.ndarray  # (F, 3) translations in metres.

    def part(self, frames: slice | np.ndarray) -> Person:
        """Return the person in the given frames."""
        return Person(self.body, self.betas, self.orient[frames], self.local[frames], self.transl[frames])

    def pose(self, points: Landmarks, offsets: np.ndarray | None = None) -> PosedLandmarks:
        """Return the body's landmarks in every frame, shifted by (L, 3) offsets in their rest frames."""
        return pose_landmarks(self.body, points, self.betas, self.orient, self.local, self.transl, offsets=offsets)

    def landmarks(self, joint_set: JointSet, offsets: np.ndarray | None = None) -> PosedLandmarks:
        """Return the keypoints of a joint set, shifted by (K, 3) offsets in their rest frames."""
        return self.pose(keypoint_landmarks(self.body, joint_set), offsets)

    def skin(self, frames: np.ndarray) -> np.ndarray:
        """Return the (n, V, 3) skin vertices in these frames."""
        return pose_mesh(self.body, self.betas, self.orient[frames], self.local[frames], self.transl[frames])

    def on_the_floor(self, fps: float) -> Person:
        """Shift the person vertically so that a sole touches the floor within every second.

        The correction is the running minimum of the sole heights over ``FLOOR_S``, smoothed with the same length. Ramps
        and stairs become flat, shorter jumps remain.
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
    """Return a person who repeats a take on the floor, with random or given shape."""
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
    """Return the (F,) smoothed minimum within ``frames`` around each frame."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(height, frames // 2, mode="edge"), 2 * (frames // 2) + 1)
    lowest = np.pad(near.min(axis=1), 2 * frames, mode="edge")
    kernel = np.exp(-0.5 * (np.arange(-2 * frames, 2 * frames + 1) / (0.5 * frames)) ** 2)
    return np.convolve(lowest, kernel / kernel.sum(), mode="valid")


_WAVES = 24  # Number of random waves in the displacement of the flesh.
_WAVELENGTH_M = 0.25  # Typical wavelength in metres, as of a calf or belly.


def strange_body(seed: int, bones: float = 0.04, flesh_mm: float = 6.0, body: Body | None = None) -> Body:
    """Return a body with proportions unlike all shapes of the solver's body.

    Every bone is stretched along its axis by a random factor and carries its children. The skin follows by its weights
    and is then displaced by a smooth random field. Joints follow the skin, so keypoints also move.

    Args:
        bones: relative standard deviation of bone lengths. Left and right are equal.
        flesh_mm: standard deviation of the skin's displacement along each axis.
        body: body to change, ours if None.
    """
    body, rng = body or load_body(), np.random.default_rng(seed)
    # The right side takes the left's values. A joint's partner is nearest to its mirror image.
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
    """Return (N, 3) displacements of unit variance per axis at (N, 3) points, from a sum of random waves."""
    waves = rng.normal(size=(_WAVES, 3)) * (2 * np.pi / _WAVELENGTH_M / np.sqrt(3.0))
    phases, heights = rng.uniform(0, 2 * np.pi, _WAVES), rng.normal(size=(_WAVES, 3))
    return np.sqrt(2.0 / _WAVES) * np.cos(points @ waves.T + phases) @ heights
