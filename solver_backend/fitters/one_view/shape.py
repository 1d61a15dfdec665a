"""Estimate a person's body shape from limb lengths and planted soles in one view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.exchange.stands import SPEED_M_S, steps
from solver_backend.fitters.person_shape import ALONG_SIGHT, SLOW_SHARE
from solver_backend.priors.lifted_take import LEAST_POINTS, LiftedTake

# Chosen on simulated people with motion of subjects 08 and 60, which no result table uses, unless stated otherwise.
POINT_M, OUTLIER_M = 0.05, 0.12  # Error of a lifted point across the line of sight, and robust scale for this error.
FOOT_M = 0.016  # The same for planted feet, which anchor the lifted pose: the detector's error (15.8 mm measured).
SOLE_M, OUTLIER_SOLE_M, WIDEST_SOLE_M = 0.012, 0.06, 1.0
"""Error and outlier distance of a planted sole's height in metres, and outlier distance for the first step."""
ALIKE_S = 0.7  # Time in seconds within which frames have correlated errors and count once.
SOLE_DEPTH_M = 0.008  # Vertices up to this height above the lowest one belong to the sole.
LOWER_M = 0.03  # The lower sole may be planted, and so may the other one if it is within this height.
SHOES_M = 0.005  # Deviation of the feet's height above the floor, due to shoes, mats and calibration.
WIDER = 3.0  # Factor applied to the deviation of adult statures, because children and athletes are also filmed.
STATURE_M = 1e-4  # Error of a given stature, which is nearly a constraint.
LEAST_STANDS, LEAST_SEEN, MOST_FRAMES, ROUNDS = 5, 0.3, 400, 8
"""Fewest frames with a planted sole, smallest share of frames with a foot keypoint, and most frames and steps."""
SHIN_RISES = 0.5
"""Smallest height of the knee above the ankle, relative to their distance, if the foot is on its sole. In lifted poses
from 28 simulated walks, obstacles, squats, dances and seats, flat feet have at least 0.59, and kneeling ones usually 0
to 0.5. If people crouch or push hard, standing feet also have less."""
MOST = 0.5  # Smallest share of frames with such feet among those with planted feet. Otherwise, the person is kneeling.
STATURES_M = (1.1, 2.25)  # Statures outside contradict the floor: six-year-old children to the tallest athletes.
OFF_FLOOR_M = 0.05  # Planted soles that are farther from the floor contradict it.
UP = np.array([0.0, 0.0, 1.0])
_SOLES, _ANKLES = ("heel", "big_toe", "small_toe"), ("ankle",)


@dataclass(frozen=True)
class SeenShape:
    """Body shape of a person as estimated from one camera."""

    betas: np.ndarray  # (10,)
    stature_m: float  # Stature of this shape.
    sigma: float  # Relative deviation of the stature if the pose is exact.
    sole_m: float  # Median height of planted soles above the floor with this shape, metres. NaN if there are none.
    pose_sigma: float = 0.0  # Relative deviation of the stature due to errors of the lifted pose.

    @property
    def fits_people(self) -> bool:
        """True if the stature is plausible and planted soles are on the floor."""
        return STATURES_M[0] < self.stature_m < STATURES_M[1] and abs(self.sole_m) < OFF_FLOOR_M


def foot_vertices(body: Body, side: str) -> np.ndarray:
    """Return the vertices with most of their skinning weight on a foot's ankle or on joints below it."""
    joints, parents = body.layout.joints, body.layout.parents
    below = [joints.index(f"{side}_ankle")] if f"{side}_ankle" in joints else []
    for joint, parent in enumerate(parents):
        below += [joint] if parent in below else []
    return np.flatnonzero(body.weights[:, below].sum(axis=1) > 0.5)


def sole_heights(body: Body, landmarks: Landmarks) -> tuple[np.ndarray, np.ndarray]:
    """Return keypoint heights (L,) above the sole at rest, and derivatives w.r.t. the shape."""
    feet = np.concatenate([foot_vertices(body, "left"), foot_vertices(body, "right")])
    feet = feet if len(feet) else np.arange(len(body.v_template))
    lowest = feet[np.argmin(body.v_template[feet, 1])]
    rest = landmarks.anchors.sum(axis=1)[:, 1] - body.v_template[lowest, 1]
    return rest, landmarks.shapedirs.sum(axis=1)[:, 1] - body.shapedirs[lowest, 1]


def with_soles(body: Body, landmarks: Landmarks) -> Landmarks:
    """Append four sole points per foot (heel, toe, inner and outer edge) to the landmarks."""
    names, vertices = list[str](), list[int]()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        foot = foot_vertices(body, side)
        if not len(foot):
            continue
        foot = foot[body.v_template[foot, 1] < body.v_template[foot, 1].min() + SOLE_DEPTH_M]
        ahead, outward = body.v_template[foot, 2], sign * body.v_template[foot, 0]
        ends = (("heel", -ahead), ("toe", ahead), ("inner", -outward), ("outer", outward))
        names += [f"{side}_sole_{end}" for end, _ in ends]
        vertices += [int(foot[np.argmax(along)]) for _, along in ends]
    soles = Landmarks.of_points(
        tuple(names), body.v_template[vertices], body.shapedirs[vertices], body.weights[vertices]
    )
    fields = ("weights", "anchors", "shapedirs")
    joined = (np.concatenate([getattr(landmarks, name), getattr(soles, name)]) for name in fields)
    return Landmarks((*landmarks.names, *names), *joined)


def foot_columns(names: tuple[str, ...], seen: np.ndarray) -> list[int]:
    """Return the columns of the keypoints that can show a planted foot.

    ``seen`` (L,) is the share of frames that show each keypoint.
    """
    found = []
    for side in ("left", "right"):
        for parts in (_SOLES, _ANKLES):
            columns = [k for k, name in enumerate(names) if name in {f"{side}_{part}" for part in parts}]
            columns = [k for k in columns if seen[k] > LEAST_SEEN]
            if columns:
                found += columns
                break
    return found


def standing_soles(
    points: np.ndarray, heights: np.ndarray, up: np.ndarray, sight: np.ndarray, fps: float
) -> np.ndarray:
    """Return an (F, K) mask of foot points that are low and slow, as on a planted foot.

    Args:
        points: (F, K, 3) points on the feet in metres, NaN where unseen.
        heights: (K,) heights of the points above a planted sole in metres.
        up: (3,) unit vector against gravity.
        sight: (F, 3) unit direction from the camera to the person.
    """
    way, seconds = steps(points, fps)
    along = np.einsum("fka,fa->fk", way, sight)[..., None] * sight[:, None]
    speed = np.linalg.norm(way - (1.0 - 1.0 / ALONG_SIGHT) * along, axis=-1) / seconds
    known = np.isfinite(speed)
    fast = np.percentile(speed[known], 90.0) if known.any() else 0.0
    soles = np.where(known, points @ up - heights, np.inf)
    lower = soles <= soles.min(axis=1, keepdims=True, initial=np.inf) + LOWER_M
    return known & lower & (np.nan_to_num(speed, nan=np.inf) < max(SPEED_M_S, SLOW_SHARE * float(fast)))


def rising_shins(points: np.ndarray, names: tuple[str, ...], feet: list[int], up: np.ndarray) -> np.ndarray:
    """Return an (F, K) mask of the foot points ``feet`` whose shin points upwards. Kneeling shins do not point upwards.

    Args:
        points: (F, L, 3) points of the pose in metres. Feet without a knee or ankle are True.
        up: (F, 3) unit vectors against gravity.
    """
    rising = np.ones((len(points), len(feet)), dtype=bool)
    for column, foot in enumerate(feet):
        shin = [f"{names[foot].partition('_')[0]}_{part}" for part in ("ankle", "knee")]
        if set(shin) <= set(names):
            ankle, knee = (points[:, names.index(name)] for name in shin)
            rising[:, column] = ((knee - ankle) * up).sum(-1) > SHIN_RISES * np.linalg.norm(knee - ankle, axis=-1)
    return rising


def fit_shape(
    take: LiftedTake,
    body: Body,
    landmarks: Landmarks,
    turn_sigma: np.ndarray,
    floor: tuple[np.ndarray, np.ndarray] | None,
    stature_m: float = 0.0,
) -> SeenShape:
    """Fit the body shape to a lifted take by Gauss-Newton steps.

    ``min Σ_f e [Σ_i |(p_i + t)_xy - x_i (p_i + t)_z|² / σ_i² + Σ_s (h_s - o)² / σ_h²] + |β|² + o² / σ_o²``. p_i are
    points of the posed body with shape β, t is the body's position, which is eliminated, and x_i are keypoints in focal
    lengths. e is the share of new information per frame. h_s are the heights of planted soles above the floor, and o is
    the height of the shoes. The fit assumes that the pose is exact. Joint rotations ω would change the stature by
    ``Σ g·ω``, so ``pose_sigma² = Σ_fj |g_fj|² σ_fj² / e`` for errors that last for ``ALIKE_S``.

    Args:
        turn_sigma: (F, 1 + J) standard deviations of the lifted rotations of root and solved joints, in radians.
        floor: camera rotations (F, 3, 3) from the world and centres (F, 3) in metres, over a floor at z = 0, or None.
        stature_m: given stature in metres, 0 if unknown.
    """
    weight = np.where(np.isfinite(take.image).all(-1), take.confidence, 0.0)
    betas = np.zeros(body.shapedirs.shape[-1])
    points, places = take.placed(body, landmarks, betas)
    shown = np.flatnonzero(((weight > 0).sum(axis=1) >= LEAST_POINTS) & np.isfinite(places).all(axis=1))
    frames = shown[:: max(1, len(shown) // MOST_FRAMES)]
    share = min(1.0, max(1.0, len(shown) / (ALIKE_S * take.fps)) / max(len(frames), 1))
    rest, by_rest = sole_heights(body, landmarks)
    feet = foot_columns(landmarks.names, (weight[shown] > 0).mean(axis=0)) if floor is not None and len(shown) else []
    R, centre = floor if floor is not None else (np.tile(np.eye(3), (len(points), 1, 1)), np.zeros((len(points), 3)))
    seen = np.where(weight[..., None] > 0, points, np.nan)[:, feet] @ R + centre[:, None]
    sight = (take.view.sight[:, None, 2] @ R)[:, 0]
    stands = standing_soles(seen, rest[feet] + by_rest[feet] @ betas, UP, sight, take.fps)[frames]
    soles = stands & rising_shins(points[frames], landmarks.names, feet, R[frames, :, 2])
    up, height = R[frames, :, 2], centre[frames, 2, None]
    stands = soles & (soles.any(axis=1).sum() >= max(LEAST_STANDS, MOST * stands.any(axis=1).sum()))
    x = np.where(weight[frames, :, None] > 0, take.image[frames], 0.0)
    sigma_m = np.full(weight[frames].shape, POINT_M)
    sigma_m[:, feet] = np.where(stands, FOOT_M, POINT_M)
    rows = np.zeros((*x.shape, 3))
    rows[..., 0, 0] = rows[..., 1, 1] = 1.0
    rows[..., 2] = -x
    shift = places[frames]
    high, low = (int(pick(body.v_template[:, 1])) for pick in (np.argmax, np.argmin))
    by_stature = body.shapedirs[high, 1] - body.shapedirs[low, 1]
    # The last unknown is the height of the shoes' soles, which is common to all frames.
    known = np.diag([*np.ones(len(betas)), SHOES_M**-2])
    known[:-1, :-1] -= (1.0 - WIDER**-2) * np.outer(by_stature, by_stature) / max(by_stature @ by_stature, 1e-12)
    by_stature = np.append(by_stature, 0.0)
    betas = np.append(betas, 0.0)
    slopes = np.concatenate([by_rest[feet], np.ones((len(feet), 1))], axis=1)
    inverse, sole, by_pose = known, np.nan, 0.0
    for outlier in np.geomspace(WIDEST_SOLE_M, OUTLIER_SOLE_M, ROUNDS):
        pose = (take.view.root[frames], take.local[frames], np.zeros((len(frames), 3)))
        posed = pose_landmarks(body, landmarks, betas[:-1], *pose, jacobian=True)
        p, J = np.asarray(posed.points) + shift[:, None], np.asarray(posed.by_betas)
        J = np.concatenate([J, np.zeros((*J.shape[:-1], 1))], axis=-1)
        off, by_betas = np.einsum("flka,fla->flk", rows, p), np.einsum("flka,flab->flkb", rows, J)
        W = share * weight[frames] / sigma_m**2 * (OUTLIER_M**2 / ((off**2).sum(-1) + OUTLIER_M**2)) ** 2
        h = np.einsum("fla,fa->fl", p[:, feet], up) + height - rest[feet] - slopes @ betas
        by_height = np.einsum("flab,fa->flb", J[:, feet], up) - slopes
        V = np.where(stands, share / SOLE_M**2 / (1.0 + (h / outlier) ** 2) ** 2, 0.0)
        V /= np.maximum(stands.sum(axis=1, keepdims=True), 1)
        A = np.einsum("fl,flka,flkb->fab", W, rows, rows) + np.einsum("fl,fa,fb->fab", V, up, up)
        B = np.einsum("fl,flka,flkb->fab", W, rows, by_betas) + np.einsum("fl,fa,flb->fab", V, up, by_height)
        C = np.einsum("fl,flka,flkb->ab", W, by_betas, by_betas) + np.einsum("fl,fla,flb->ab", V, by_height, by_height)
        a = np.einsum("fl,flka,flk->fa", W, rows, off) + np.einsum("fl,fl,fa->fa", V, h, up)
        c = np.einsum("fl,flkb,flk->b", W, by_betas, off) + np.einsum("fl,fl,flb->b", V, h, by_height)
        C, c = C + known, c + known @ betas
        if stature_m:
            C += np.outer(by_stature, by_stature) / STATURE_M**2
            c += by_stature * (body.stature_m + by_stature @ betas - stature_m) / STATURE_M**2
        solved = np.linalg.solve(A + 1e-6 * np.eye(3), np.concatenate([B, a[..., None]], axis=-1))
        inverse = np.linalg.inv(C - np.einsum("fab,fac->bc", B, solved[..., :-1]))
        step = -inverse @ (c - np.einsum("fab,fa->b", B, solved[..., -1]))
        shift = shift - solved[..., -1] - solved[..., :-1] @ step
        betas = betas + step
        sole = float(np.median(h[stands]) + betas[-1]) if stands.any() else np.nan
        # Slope of the stature w.r.t. each point and each rotation, with the frames' positions eliminated.
        to_stature = inverse @ by_stature / (body.stature_m + by_stature @ betas)
        moved = (by_betas - np.einsum("flka,fab->flkb", rows, solved[..., :-1])) @ to_stature
        raised = (by_height - np.einsum("fa,fab->fb", up, solved[..., :-1])[:, None]) @ to_stature
        pull = np.einsum("fl,flk,flka->fla", W, moved, rows)
        pull[:, feet] += (V * raised)[..., None] * up[:, None]
        by_turns = np.einsum("fla,flam->fm", pull, np.asarray(posed.by_rotations)).reshape(*turn_sigma[frames].shape, 3)
        by_pose = float(np.sqrt(((by_turns**2).sum(axis=-1) * turn_sigma[frames] ** 2).sum() / share))
    stature = body.stature_m + float(by_stature @ betas)
    sigma = float(np.sqrt(by_stature @ inverse @ by_stature)) / stature
    return SeenShape(betas[:-1], stature, sigma, sole, by_pose)
