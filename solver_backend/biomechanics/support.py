"""Find the body's floor contacts, its depth in the floor, and its balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.contact_parts import CONTACT_PARTS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Motion
from solver_backend.types.shapes import Float

SIGMA_M, SIGMA_M_S = 0.02, 0.2
"""Standard deviations of the height (m) and speed (m/s) of a point that touches the floor. Both are chosen by hand,
because skin and shoes deform, and a solve smooths the moment when a foot stops."""
MOST_SAMPLES = 120  # Largest number of frames examined. Longer takes are sampled evenly.
AIR_M = 0.1  # A body is in the air if its lowest skin is at least this high above the floor, in metres.
JUMP_S = 1.0  # Longest time in the air, in seconds. A jump of 1 s raises the body by g T² / 8 = 1.2 m, out of reach.
FLOOR_M = 0.05  # Largest height in metres of the soles above the world's floor. Otherwise the floor is not at z = 0.
LEVEL = 0.25
"""Fraction of frames in which the lowest skin is below the floor level. The level therefore includes shoe soles. With
the world's floor instead, a person squatting in shoes (nimble, squats1) was in the air for 47 % of the take."""
DIRECTIONS = 72  # Number of directions of the support polygon's edges. The distance is at most 0.1 % too large.


@dataclass(frozen=True)
class Support:
    """Floor contacts and balance in S sampled frames of a motion."""

    centre: Float[np.ndarray, "samples 3"]  # Centre of mass of a body of uniform density, metres.
    probability: dict[str, Float[np.ndarray, " samples"]]  # Probability of floor contact, by height and speed.
    depth_m: Float[np.ndarray, " samples"]  # Depth of the lowest skin below z = 0, or 0 if it is above.
    margin_m: Float[np.ndarray, " samples"]
    """Signed distance in metres, seen from above, from the centre of mass to the edge of the touching skin's convex
    hull. Negative outside, NaN without contact."""
    longest_flight_s: float  # Longest time over all frames with all skin above ``AIR_M``.

    @property
    def is_floating(self) -> bool:
        """True if the body stays in the air for longer than any jump."""
        return self.longest_flight_s > JUMP_S


def find_support(motion: Motion, body: Body) -> Support | None:
    """Find a motion's floor contacts and balance, or return None if its floor is not at z = 0.

    The contact probability of a skin point is ``exp(-(max(z, 0) / σ)² / 2 - (v / τ)² / 2)`` at height z and speed v.
    The most likely point of a body part gives the part's probability. σ and τ are ``SIGMA_M`` and ``SIGMA_M_S``.
    """
    frames = motion.num_frames
    own = np.arange(0, frames, -(-frames // MOST_SAMPLES))
    around = np.clip([own - 1, own, own + 1], 0, frames - 1)  # Speed needs neighbouring frames, however long the take.
    sample, places = np.unique(around, return_inverse=True)
    before, here, after = places.reshape(3, -1)
    turns = motion.body_pose.reshape(motion.num_frames, -1, 3)[sample, : body.layout.num_solved].astype(np.float64)
    root, transl = (values[sample].astype(np.float64) for values in (motion.global_orient, motion.transl))
    skin = pose_mesh(body, motion.betas.astype(np.float64), exp_so3(root), exp_so3(turns), transl, correctives=False)
    seconds = np.maximum(around[2] - around[0], 1)[:, None] / motion.fps
    speed = np.linalg.norm(skin[after] - skin[before], axis=-1) / seconds
    below = motion.joints[..., 2].min(axis=1)  # Over all frames. The skin is lower by a nearly constant depth.
    skin = skin[here]
    lowest = skin[..., 2].min(axis=1)
    level = float(np.quantile(lowest, LEVEL))
    if abs(level) > FLOOR_M:
        return None
    chance = np.exp(-0.5 * (np.maximum(skin[..., 2] - level, 0.0) / SIGMA_M) ** 2 - 0.5 * (speed / SIGMA_M_S) ** 2)
    owner, joints = body.weights.argmax(axis=1), body.layout.joints
    probability = {}
    for part, names in CONTACT_PARTS.items():
        skinned = np.isin(owner, [joints.index(name) for name in names if name in joints])
        probability[part.replace("_", " ")] = chance[:, skinned].max(axis=1, initial=0.0)
    centre = _centres_of_mass(skin, body.faces)
    touching = [points[near > 0.5, :2] for points, near in zip(skin, chance, strict=True)]
    margin = np.array([_margin(points, c[:2]) for points, c in zip(touching, centre, strict=True)])
    height = below + np.interp(np.arange(frames), own, lowest - below[own]) - level
    edges = np.flatnonzero(np.diff(np.r_[0, height > AIR_M, 0]))
    flight = float(max((edges[1::2] - edges[::2]) / motion.fps, default=0.0))
    return Support(centre, probability, np.maximum(-lowest, 0.0), margin, flight)


def _centres_of_mass(skin: np.ndarray, faces: np.ndarray) -> np.ndarray:
    found = np.empty((len(skin), 3))
    for k, points in enumerate(skin):
        middle = points.mean(axis=0)
        a, b, c = (points[faces[:, i]] - middle for i in range(3))
        volume = np.einsum("ti,ti->t", a, np.cross(b, c))
        found[k] = middle + (volume @ (a + b + c)) / (4.0 * volume.sum())
    return found


def _margin(touching: np.ndarray, centre: np.ndarray) -> float:
    """Return the distance from ``centre`` c to the edge of the convex hull of ``touching`` points p, positive inside.

    The distance is ``min_u (max_i u·p_i - u·c)`` over unit vectors u. Without points, the result is NaN.
    """
    if not len(touching):
        return np.nan
    angles = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    u = np.stack([np.cos(angles), np.sin(angles)])
    return float(((touching - centre) @ u).max(axis=0).min())
