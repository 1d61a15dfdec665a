"""Lift the keypoints of one camera to 3D: poses in camera axes, and positions of a given body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.body.rest_skeleton import BODY_MIRROR, MIRROR
from solver_backend.cameras.projection import undistort
from solver_backend.geometry.arrays import bridges
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import matrix_from_6d, matrix_to_6d
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.view_lifter import LiftedView, load_view_lifter
from solver_backend.types import Cameras, JointSet, Keypoints2D

_ROUNDS = 6  # Number of reweighted solves.
_SCALE_M = 0.12  # Distance in metres from its ray at which a point loses weight: the error of lifted limbs.
_SMOOTH_S = 0.15  # Standard deviation in seconds for averaging positions, as single distances vary by a few percent.
_NEAREST_M = 0.3  # Smallest depth of a person in front of a camera in metres. Chosen by hand.


def place_before_camera(points: np.ndarray, image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the shifts t (F, 3) in camera axes that bring points closest to their viewing rays, or NaN without points.

    The residuals of ``Σ_i w_i |(p_i + t)_xy - x_i (p_i + t)_z|²`` are linear in t. Points far from rays weigh less.

    Args:
        points: (F, L, 3) points p in camera axes, in metres.
        image: (F, L, 2) image points x in focal lengths.
        weight: (F, L) weights, 0 for unseen points.
    """
    weight = np.where(np.isfinite(image).all(-1), weight, 0.0)
    x = np.where(weight[..., None] > 0, image, 0.0)
    rows = np.zeros((*points.shape[:2], 2, 3))
    rows[..., 0, 0] = rows[..., 1, 1] = 1.0
    rows[..., 2] = -x
    target = x * points[..., 2:] - points[..., :2]
    robust = np.ones_like(weight)
    enough = (weight > 0).sum(axis=1) >= 3
    shift = np.zeros((len(points), 3))
    for _ in range(_ROUNDS):
        W = weight * robust
        H = np.einsum("fl,flka,flkb->fab", W, rows, rows) + 1e-9 * np.eye(3)
        g = np.einsum("fl,flka,flk->fa", W, rows, target)
        shift = np.linalg.solve(H, g[..., None])[..., 0]
        off = np.linalg.norm(np.einsum("flka,fa->flk", rows, shift) - target, axis=-1)
        robust = (_SCALE_M**2 / (off**2 + _SCALE_M**2)) ** 2
    middle = shift[:, 2] + np.median(points[..., 2], axis=1)
    return np.where((enough & (middle > _NEAREST_M))[:, None], shift, np.nan)


def smoothed_places(places: np.ndarray, fps: float) -> np.ndarray:
    """Smooth (F, 3) positions over time with a Gaussian. Missing positions (NaN) remain missing."""
    half = max(1, round(3 * _SMOOTH_S * fps))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / (_SMOOTH_S * fps)) ** 2)
    known = np.isfinite(places).all(axis=1)
    filled = np.where(known[:, None], places, 0.0)
    total = np.convolve(known.astype(float), kernel)[half : half + len(places)]
    summed = np.stack([np.convolve(column, kernel)[half : half + len(places)] for column in filled.T], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where((known & (total > 0))[:, None], summed / total[:, None], np.nan)


@dataclass(frozen=True)
class LiftedTake:
    """Keypoints of one camera and the poses lifted from them, in F frames."""

    view: LiftedView
    z: np.ndarray  # (F, d) codes of the prior.
    local: np.ndarray  # (F, J, 3, 3) decoded rotations.
    image: np.ndarray  # (F, L, 2) keypoints in focal lengths from the principal point, NaN where missing.
    confidence: np.ndarray  # (F, L), 0 where missing.
    fps: float

    @property
    def up(self) -> np.ndarray:
        """Unit vector (3,) against gravity in camera axes, estimated from all frames."""
        seen = (self.confidence > 0).sum(axis=1) >= LEAST_POINTS
        up = self.view.up[seen if seen.any() else slice(None)].sum(axis=0)
        return up / max(float(np.linalg.norm(up)), 1e-9)

    def placed(self, body: Body, landmarks: Landmarks, betas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a person's landmarks (F, L, 3) and translations (F, 3) for a body shape, in metres in camera axes."""
        still = np.zeros((len(self.local), 3))
        points = np.asarray(pose_landmarks(body, landmarks, betas, self.view.root, self.local, still).points)
        places = smoothed_places(place_before_camera(points, self.image, self.confidence), self.fps)
        return points + places[:, None], places

    def off_rays(self, body: Body, landmarks: Landmarks) -> np.ndarray:
        """Return the mean distances (F,) in metres from an average person's landmarks to the keypoints' rays."""
        points, _ = self.placed(body, landmarks, np.zeros(body.shapedirs.shape[-1]))
        seen = self.confidence > 0
        off = np.linalg.norm(points[..., :2] - np.where(seen[..., None], self.image, 0.0) * points[..., 2:], axis=-1)
        count = seen.sum(axis=1)
        return np.where(count > 0, np.where(seen, off, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


LEAST_POINTS = 6  # Smallest number of keypoints in a frame that shows a person.


def lift_take(
    camera: Cameras,
    keypoints: Keypoints2D,
    body: Body,
    prior: AutoencodingPrior | None = None,
    up: np.ndarray | None = None,
) -> LiftedTake:
    """Lift one camera's keypoints and their mirror image to 3D, and average the two results.

    Args:
        camera: a single camera. Only its lens is used.
        prior: pose decoder for this body. None uses SPoser's.
        up: (3,) or (F, 3) unit vector against gravity in camera axes, None if unknown.

    Raises:
        FileMissing, WeightsInvalid: see ``load_view_lifter``.
    """
    image = np.asarray(undistort(camera, keypoints.xy))[0]
    confidence = np.where(np.isfinite(image).all(axis=-1), keypoints.confidence[0], 0.0)
    view = _lifted_twice(image, confidence, keypoints.joint_set, keypoints.fps, up)
    z, prior = view.z, prior or prior_on_body(load_sposer(), body.layout)
    if prior.metadata.get("sha256") != load_view_lifter().metadata["sposer_sha256"]:  # the lifter's codes are SPoser's
        z = np.asarray(prior.encode(prior_on_body(load_sposer(), body.layout).decode(z)))
    return LiftedTake(view, z, np.asarray(prior.decode(z)), image, confidence, keypoints.fps)


BRIDGED_S, BRIDGED_CONFIDENCE = 1.0, 0.3
"""Longest gap in a keypoint, in seconds, that is interpolated, and the confidence given to the interpolated points."""


def bridge_gaps(image: np.ndarray, confidence: np.ndarray, longest: int) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate each image point across gaps of at most ``longest`` frames.

    Args:
        image: (F, L, 2) points, arbitrary where the confidence (F, L) is 0.
    """
    before, after, share = bridges(confidence > 0, longest)
    bridged, share, column = before < after, share[..., None], np.arange(image.shape[1])
    between = (1.0 - share) * image[before, column] + share * image[after, column]
    return np.where(bridged[..., None], between, image), np.where(bridged, BRIDGED_CONFIDENCE, confidence)


_SIDEWAYS = np.diag([-1.0, 1.0, 1.0])  # Mirrors points in the body's sagittal plane, and in the camera's.


def _lifted_twice(
    image: np.ndarray, confidence: np.ndarray, joint_set: JointSet, fps: float, up: np.ndarray | None
) -> LiftedView:
    """Lift a view and its mirror image, and return the mean, because their errors are partly independent.

    If the two poses face opposite directions in a frame, their mean would face sideways. The pose of the view that is
    not mirrored is then used.
    """
    lifter, sposer, columns = load_view_lifter(), load_sposer(), list(joint_set.mirrored(image.shape[1]))
    image, confidence = bridge_gaps(image, confidence, round(BRIDGED_S * fps))
    first = lifter(image, confidence, joint_set.keypoints, fps, up)
    seen = image[:, columns] * [-1.0, 1.0], confidence[:, columns]
    second = lifter(*seen, joint_set.keypoints, fps, None if up is None else up @ _SIDEWAYS)
    mirrored = np.asarray(sposer.decode(second.z))[:, list(BODY_MIRROR)]
    codes = np.asarray(sposer.encode(_SIDEWAYS @ mirrored @ _SIDEWAYS))
    root = _SIDEWAYS @ second.root @ _SIDEWAYS
    alike = np.einsum("fab,fab->f", first.root, root) > 1.0  # less than 90 degrees apart
    codes, root = np.where(alike[:, None], codes, first.z), np.where(alike[:, None, None], root, first.root)
    up_twice = first.up + second.up @ _SIDEWAYS
    return replace(
        first,
        z=spherical_normalisation(first.z + codes),
        root=matrix_from_6d(matrix_to_6d(first.root) + matrix_to_6d(root)),
        up=up_twice / np.maximum(np.linalg.norm(up_twice, axis=1, keepdims=True), 1e-9),
        sigma_m=0.5 * (first.sigma_m + second.sigma_m[:, list(MIRROR)]),
    )


UP_RAD = 0.17  # Error of the lifter's up direction over a take, per axis: 10 degrees, common to most frames.
FLOOR_M, FEET_ALIKE_S = 0.1, 0.5  # Error of the lower sole's height in metres, and its correlation time in seconds.
STANDING_PERCENT = 20.0
"""Percentile of the lower sole's heights that gives the height of a planted sole. In four takes of subjects 08 and 60
and four training takes, feet then skate by 0.003 cm per frame, or by 0.005 if the median is used."""
SOLE_M, ANKLE_M = 0.02, 0.08  # Heights in metres of a standing foot's heel or toe, and of its ankle.
_FEET = {
    f"{side}_{part}": height
    for side in ("left", "right")
    for part, height in (("heel", SOLE_M), ("big_toe", SOLE_M), ("ankle", ANKLE_M))
}
_UP = np.array([0.0, 0.0, 1.0])


def lowest_feet(points: np.ndarray, names: tuple[str, ...], seen: np.ndarray) -> float | None:
    """Estimate the height in metres of a planted sole, or return None if no foot is visible.

    The estimate is a low percentile of the lower sole's heights, because dancers and jumpers rarely plant their feet.
    """
    soles = lower_soles(points, names, seen, _UP)
    return float(np.percentile(soles[:, 2], STANDING_PERCENT)) if len(soles) else None


def lower_soles(points: np.ndarray, names: tuple[str, ...], seen: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return the lower sole's position (n, 3) in the n frames with a visible foot. ``up`` (3,) points upwards."""
    frames, column = _lower(points, names, seen, up)
    drop = np.array([_FEET.get(name, 0.0) for name in names])
    return points[frames, column] - drop[column, None] * up


def _lower(
    points: np.ndarray, names: tuple[str, ...], seen: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the n frames with a visible foot, and the column of each frame's foot point with the lowest sole."""
    columns = np.array([k for k, name in enumerate(names) if name in _FEET], dtype=int)
    if not len(columns):
        return columns, columns
    drop = np.array([_FEET[names[k]] for k in columns])
    height = np.where(seen[:, columns], points[:, columns] @ up - drop, np.inf)
    known = np.isfinite(height).any(axis=1) & np.isfinite(points[:, columns]).all(axis=(1, 2))
    return np.flatnonzero(known), columns[np.argmin(height[known], axis=1)]


def up_by_floor(
    take: LiftedTake, points: np.ndarray, names: tuple[str, ...], expected: np.ndarray | None = None
) -> np.ndarray:
    """Tilt the lifter's up direction (3,) so that the feet come closer to one height.

    The tilt δ minimises ``n/N Σ (h_i - h̄)² / σ_h² + |δ|² / σ_u²``. h are the heights of the lower sole in N frames, n
    of which are independent. ``points`` (F, L, 3) are in camera axes. They may also be in other axes, if ``expected``
    is the up direction in these axes.
    """
    expected = take.up if expected is None else expected
    up: np.ndarray = expected
    seen = take.confidence > 0
    for _ in range(3):
        soles = lower_soles(points, names, seen, up)
        if len(soles) < 2:
            return up
        about = soles - np.median(soles, axis=0)
        side = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
        tangents = np.stack([side, np.cross(up, side)]) / np.linalg.norm(side)
        A, h = about @ tangents.T, about @ up
        weight = max(1.0, len(soles) / (FEET_ALIKE_S * take.fps)) / (len(soles) * FLOOR_M**2)
        off = expected @ tangents.T
        tilt = np.linalg.solve(weight * A.T @ A + np.eye(2) / UP_RAD**2, off / UP_RAD**2 - weight * A.T @ h)
        up = up + tilt @ tangents
        up /= np.linalg.norm(up)
    return up
