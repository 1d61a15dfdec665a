"""Use the poses from a network as measurements, with a covariance estimated from the take."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid, MotionInvalid
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.fitters.model.subject import FrameObjective, FrameStates
from solver_backend.fitters.one_view.depth import OneCamera
from solver_backend.fitters.problem import Layer, Measurements, RoughMotion, noted
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.rotations import matrix_from_6d, matrix_to_6d
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.lifted_take import place_before_camera
from solver_backend.residuals.positions import RelativePositionTerm
from solver_backend.types import Capture
from solver_backend.types.network_result import NetworkResult, StartingResult

ALIKE_S = 0.03  # Frames within this time count as one. Chosen on takes of subjects 08 and 60.
LEAST_SIGMA_M = 0.01  # Smallest deviation per axis of a network's point, because body shapes differ.
LEAST_FRAMES, LEAST_COVERED = 5, 0.3  # Fewest frames of a result that fit the take, and smallest share of the take.
LEAST_POINTS = 6  # Smallest number of points needed to position a result in front of the camera.
FITS_M, CHANCE = 0.12, 0.7
"""Largest distance in metres of points from their rays for a match, and largest ratio to the distance in other
alignments."""
DOUBTED = 1.5
"""Factor applied to the deviations of lifted poses and triangulated points to allow for rare large errors. Measured on
subjects 08 and 60."""
BETTER = 0.85  # Another alignment replaces the file's frame numbers if its distance is below this share.
SIZE_ALIKE = (0.8, 1.25)  # Scale factors within these limits leave the result's size unchanged.
_SCAN_FRAMES, _SCAN_SHIFTS = 60, 900  # Number of frames compared per shift, and largest shift in frames.
_BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))


@dataclass(frozen=True)
class NetworkPoses(Layer):
    """Layer of a solve: a network's poses relative to the pelvis, from one camera's video."""

    camera: str
    term: RelativePositionTerm
    sigma_m: np.ndarray  # (L, 2) deviation of each point per axis, across and along the line of sight.

    def terms(self) -> FrameObjective:
        """Return the term that draws the body to the network's poses."""
        return FrameObjective((), relative=(self.term,))


@dataclass(frozen=True)
class _View:
    """View of one camera with keypoints for L landmarks. Landmarks without a keypoint are NaN."""

    name: str
    R: np.ndarray  # (3, 3) from the world to the camera.
    image: np.ndarray  # (F, L, 2) keypoints in focal lengths, NaN where missing.
    weight: np.ndarray  # (F, L)
    mirrored: np.ndarray  # (L,) column of the corresponding point on the other side.
    focal: float  # Focal length in pixels.
    fps: float


@dataclass(frozen=True)
class _Match:
    """Person in a network result, and the frame alignment that best fits the take."""

    person: NetworkResult
    points: np.ndarray  # (F, L, 3) in the camera's axes, NaN where the result has none.
    rows: np.ndarray  # (F,) rows of the person in the take's frames, -1 where the result has none.
    off_m: float  # Median distance of its points from their rays.
    reason: str  # Method that matched the frames. Empty if the file's frame numbers matched.

    @property
    def local(self) -> np.ndarray | None:
        """(F, 22, 3, 3) rotations, arbitrary where unknown. None if the result consists of points."""
        return None if self.person.local is None else self.person.local[np.maximum(self.rows, 0)]

    def of_points(self, points: np.ndarray) -> _Match:
        """Return the match with new result points (n, L, 3), placed at the take's frames."""
        known = (self.rows >= 0)[:, None, None]
        return replace(self, points=np.where(known, points[np.maximum(self.rows, 0)], np.nan))


def with_network_results(
    measurements: Measurements,
    capture: Capture,
    body: Body,
    prior: AutoencodingPrior,
    results: Sequence[StartingResult],
    like: Array,
    *,
    is_sized: bool = False,
) -> Measurements:
    """Add a layer to the measurements for each network result.

    For a single camera, a result may also correct the person's size unless ``is_sized``, and provide the initial poses.

    Raises:
        JobInvalid: a result's camera does not exist, or several cameras exist and the result does not name one.
        MotionInvalid: a result is for another video, is mirrored, or has too few frames.
    """
    layers, found = list[NetworkPoses](), list[Diagnostic]()
    betas = np.zeros(body.shapedirs.shape[-1])
    if measurements.known_person is not None:
        betas = np.asarray(to_numpy(measurements.known_person.betas))
    for result in results:
        view = _view(capture, result, measurements.landmarks)
        match = _matched(result, view, measurements.landmarks, body, betas)
        if isinstance(measurements.source, OneCamera) and match.local is not None and not layers and not is_sized:
            measurements = _sized(measurements.source, match)
            assert measurements.known_person is not None
            betas = to_numpy(measurements.known_person.betas)
            match = match.of_points(_points(match.person, measurements.landmarks, body, betas))
        points = match.points
        sight = _sight(view)
        sigma, trust = deviations(points, view, sight, *_reference(measurements, body, sight))
        along = sight[:, None, :, None] * sight[:, None, None, :]
        across, deep = (1.0 / sigma[None, :, k, None, None] ** 2 for k in (0, 1))
        # Points on the same joint share its error and weight.
        bone = np.argmax(measurements.landmarks.weights, axis=1)
        known = np.isfinite(points).all(-1) / np.bincount(bone)[bone]
        precision = (across * (np.eye(3) - along) + deep * along) * known[..., None, None]
        share = 1.0 / max(1.0, ALIKE_S * measurements.fps)
        term = RelativePositionTerm.of(np.nan_to_num(points) @ view.R, precision, share, like)
        layers.append(NetworkPoses(view.name, term, sigma))
        found.append(_note(match, view, sigma, result))
        if isinstance(measurements.source, OneCamera):
            measurements = _surer(measurements, match, view, sigma, trust, body, prior, like)
    provenance = noted(measurements.provenance, found)
    source = measurements.source
    if isinstance(source, OneCamera):
        size, add = source.sized_by, partial(with_network_results, is_sized=True)
        source = replace(source, sized_by=lambda poses: add(size(poses), capture, body, prior, results, like))
    return replace(measurements, source=source, layers=(*layers, *measurements.layers), provenance=provenance)


def _sized(source: OneCamera, match: _Match) -> Measurements:
    """Estimate the person's size again, from the mean of the lifted pose and the result's pose.

    A wrong pose causes a wrong size, which moves the person in depth. The errors of the two poses are independent.
    """
    take, local = source.take, match.local
    assert local is not None
    shown, own = (match.rows >= 0)[:, None, None, None], np.concatenate([take.view.root[:, None], take.local], axis=1)
    theirs = own.copy()
    theirs[:, : local.shape[1]] = local[:, : own.shape[1]]
    mean = np.where(shown, matrix_from_6d(matrix_to_6d(own) + matrix_to_6d(theirs)), own)
    return source.sized_by(replace(take, view=replace(take.view, root=mean[:, 0]), local=mean[:, 1:]))


def _surer(
    measurements: Measurements,
    match: _Match,
    view: _View,
    sigma: np.ndarray,
    trust: np.ndarray,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
) -> Measurements:
    """Combine the depths of the lifted pose and of the network result for a single camera.

    If the result's depth is more precise than the lifted pose's depth, the result's poses are also the initial poses in
    the frames that it covers. ``trust`` (L,) are factors applied to the precision of the lifted points.
    """
    source, rough = measurements.source, measurements.rough
    assert isinstance(source, OneCamera)
    lifted = source.open.sight_sigma_m
    deep = np.full(lifted.shape[1], np.median(sigma[:, 1]))
    names = body.layout.recorded.joints
    for bone in range(len(body.layout.joints)):  # over joints
        points = np.argmax(measurements.landmarks.weights, axis=1) == bone
        if points.any() and body.layout.joints[bone] in names:
            deep[names.index(body.layout.joints[bone])] = np.median(sigma[points, 1])
    shown = np.isfinite(match.points).any(axis=(1, 2))
    joined = np.where(shown[:, None], (lifted**-2.0 + deep**-2.0) ** -0.5, lifted)
    fair = constant(np.where(shown[:, None], trust, 1.0)[..., None, None], like)
    own = replace(source.lifted, precision=source.lifted.precision * fair)
    source = replace(source, open=replace(source.open, sight_sigma_m=joined), lifted=own)
    measurements = replace(measurements, source=source)
    if rough is None or match.local is None or np.median(deep) >= np.median(lifted):
        return measurements
    at = rough.frames
    local = match.local[at]
    z, root = prior.encode(local[:, 1 : 1 + len(prior.joints)]), view.R.T @ local[:, 0]
    states = rough.states
    own = shown[at][:, None]
    z = np.where(own, z, to_numpy(states.z))
    root = np.where(own[..., None], root, to_numpy(states.root))
    states = FrameStates(constant(z, like), constant(root, like), states.transl)
    return replace(measurements, rough=RoughMotion(at, states))


def _view(capture: Capture, result: StartingResult, landmarks: Landmarks) -> _View:
    cameras, keypoints = capture.require_views()
    seen = np.flatnonzero((keypoints.confidence > 0).any(axis=(1, 2)))
    if result.camera and result.camera not in cameras.names:
        message = f"The capture has no camera '{result.camera}'. Its cameras are {', '.join(cameras.names)}."
        raise JobInvalid(message, where=result.file)
    if not result.camera and len(seen) > 1:
        hint = f"Write --start-from {cameras.names[seen[0]]}={result.file}, with the camera's name."
        raise JobInvalid("Several cameras see the person. Specify the result's camera.", where=result.file, hint=hint)
    if cameras.path is not None:
        hint = "Omit --start-from, or solve without --camera-path."
        raise JobInvalid("A network result cannot be used with a moving camera.", where=result.file, hint=hint)
    number = cameras.names.index(result.camera) if result.camera else int(seen[0])
    named, camera = keypoints.named, cameras.subset([number])
    image = np.asarray(undistort(camera, named.xy[[number]]))[0]
    more = len(landmarks) - image.shape[1]
    image = np.pad(image, [(0, 0), (0, more), (0, 0)], constant_values=np.nan)
    weight = np.pad(named.confidence[number], [(0, 0), (0, more)])
    weight = np.where(np.isfinite(image).all(-1), weight, 0.0)
    mirrored = np.array(named.joint_set.mirrored(len(landmarks)))
    focal = float(np.sqrt(camera.K[0, 0, 0] * camera.K[0, 1, 1]))
    return _View(cameras.names[number], camera.R[0], image, weight, mirrored, focal, named.fps)


def _points(person: NetworkResult, landmarks: Landmarks, body: Body, betas: np.ndarray) -> np.ndarray:
    """Return landmarks (F, L, 3) relative to the pelvis in camera axes, in metres, NaN where unknown."""
    if person.local is not None:
        still = np.zeros((len(person.frames), 3))
        local = person.local[:, 1:]
        return np.asarray(pose_landmarks(body, landmarks, betas, person.local[:, 0], local, still).points)
    assert person.points is not None
    columns = np.array([person.names.index(name) if name in person.names else -1 for name in landmarks.names])
    found = np.where((columns >= 0)[:, None], person.points[:, columns], np.nan)
    rest = np.asarray(pose_landmarks(body, landmarks, betas, *_at_rest(body)).points)
    theirs, ours = (_lengths(points, landmarks.names) for points in (found, rest))
    scale = float(np.nanmedian(ours / theirs)) if np.isfinite(theirs).any() else np.nan
    return found if SIZE_ALIKE[0] < scale < SIZE_ALIKE[1] else found * scale


def _at_rest(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.eye(3)[None], np.tile(np.eye(3), (1, len(body.parents) - 1, 1, 1)), np.zeros((1, 3))


def _lengths(points: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    found = []
    for start, end in _BONES:
        for side in SIDES:
            a, b = (names.index(n) if (n := f"{side}_{part}") in names else -1 for part in (start, end))
            far = np.linalg.norm(points[:, a] - points[:, b], axis=-1)
            found.append(np.median(far[np.isfinite(far)]) if min(a, b) >= 0 and np.isfinite(far).any() else np.nan)
    return np.array(found)


def distances(points: np.ndarray, view: _View, frames: np.ndarray) -> np.ndarray:
    """Return the RMS distances (F,) of points from their viewing rays in metres per axis, NaN with too few points.

    The camera model is weak perspective: ``Σ w |x - s p_xy - t|²`` is minimised over a scale s and a shift t. x are the
    keypoints, w their weights, and p the points. The distance is the RMS residual divided by s, or infinite if s is not
    positive. ``points`` (F, L, 3) belong to the take's ``frames`` (F,).
    """
    x, w = view.image[frames], np.where(np.isfinite(points).all(-1), view.weight[frames], 0.0)
    x, p = np.where(w[..., None] > 0, x, 0.0), np.where(w[..., None] > 0, points[..., :2], 0.0)
    total = np.maximum(w.sum(axis=1), 1e-9)[:, None]
    x = x - (np.einsum("fl,fla->fa", w, x) / total)[:, None]
    p = p - (np.einsum("fl,fla->fa", w, p) / total)[:, None]
    square = np.einsum("fl,fla,fla->f", w, p, p)
    scale = np.einsum("fl,fla,fla->f", w, p, x) / np.maximum(square, 1e-12)
    rest = np.einsum("fl,fla,fla->f", w, x, x) - scale**2 * square
    enough = ((w > 0).sum(axis=1) >= LEAST_POINTS) & (scale > 0)
    off = np.sqrt(np.maximum(rest, 0.0) / (2.0 * total[:, 0])) / np.where(enough, scale, 1.0)
    worst = ((w > 0).sum(axis=1) >= LEAST_POINTS) & (scale <= 0)
    return np.where(worst, np.inf, np.where(enough, off, np.nan))


def _matched(result: StartingResult, view: _View, landmarks: Landmarks, body: Body, betas: np.ndarray) -> _Match:
    """Find the person and frame alignment in a result that best fit the camera's keypoints."""
    best: tuple[float, NetworkResult, np.ndarray, np.ndarray, str] | None = None
    chance = np.inf
    for person in result.people:
        points = _points(person, landmarks, body, betas)
        own = _score(points, view, _rows(person, np.arange(len(view.image))))
        options = [(own, "", 0.0)] if np.isfinite(own) else []
        numbers = np.arange(len(view.image), dtype=float)
        length = person.frames[-1] + 1
        if length != len(numbers) and min(length, len(numbers)) >= LEAST_FRAMES:
            stretched = numbers * (length - 1) / (len(numbers) - 1)
            rate = f"its {length} frames cover the take's {len(numbers)}"
            options.append((_score(points, view, _rows(person, stretched)), rate, np.nan))
        reach = min(_SCAN_SHIFTS, max(length, len(numbers)) - LEAST_FRAMES)
        shifts = np.arange(-reach, reach + 1)
        scores = np.array([_score(points, view, _rows(person, numbers + d), _SCAN_FRAMES) for d in shifts])
        if np.isfinite(scores).any():
            at = int(np.nanargmin(scores))
            chance = min(chance, float(np.nanmedian(scores[np.isfinite(scores)])))
            shift = int(shifts[at])
            exact = _score(points, view, _rows(person, numbers + shift))
            options.append((exact, f"its frame {shift} is the take's first", float(shift)))
        for off, reason, shift in options:
            limit = 1.0 if best is None else BETTER if reason else 1.0
            if np.isfinite(off) and (best is None or off < limit * best[0]):
                where = numbers * (length - 1) / max(len(numbers) - 1, 1) if np.isnan(shift) else numbers + shift
                best = off, person, points, _rows(person, where), reason
    if best is None:
        hint = "Use a result for this camera's video and these frames."
        raise MotionInvalid("The network result covers too few frames of the take.", where=result.file, hint=hint)
    off, person, points, rows, reason = best
    if len(result.people) > 1:
        text = f", {reason}" if reason else ""
        reason = f"person {person.person} of {len(result.people)} fits best{text}"
    match = _Match(person, points, rows, off, reason).of_points(points)
    _require_not_mirrored(match.points, view, off, result)
    if off > FITS_M and off > CHANCE * chance:
        message = f"The network's poses are {100.0 * off:.0f} cm from the camera's keypoints in every alignment."
        hint = f"Check that the file is for the video of {view.name}, and that the video was not cut or converted."
        raise MotionInvalid(message, where=result.file, hint=hint)
    return match


def _rows(person: NetworkResult, numbers: np.ndarray) -> np.ndarray:
    wanted = np.round(numbers).astype(int)
    at = np.minimum(np.searchsorted(person.frames, wanted), len(person.frames) - 1)
    return np.where(person.frames[at] == wanted, at, -1)


def _score(points: np.ndarray, view: _View, rows: np.ndarray, most: int = 10**9) -> float:
    """Return the median distance in metres of aligned points from their viewing rays, NaN with too few frames."""
    frames = np.flatnonzero(rows >= 0)
    if len(frames) < max(LEAST_FRAMES, LEAST_COVERED * len(rows)):
        return np.nan
    frames = frames[:: max(1, len(frames) // most)]
    off = distances(points[rows[frames]], view, frames)
    return float(np.median(off[~np.isnan(off)])) if np.isfinite(off).sum() >= LEAST_FRAMES else np.nan


def _require_not_mirrored(points: np.ndarray, view: _View, off: float, result: StartingResult) -> None:
    mirrored = points[:, view.mirrored] * np.array([-1.0, 1.0, 1.0])
    frames = np.flatnonzero(np.isfinite(points).any(axis=(1, 2)))
    other = distances(mirrored[frames], view, frames)
    if np.isfinite(other).any() and np.median(other[~np.isnan(other)]) < BETTER * min(off, FITS_M):
        message = "The network's poses are mirrored."
        hint = "Run the network on the original video, without mirroring."
        raise MotionInvalid(message, where=result.file, hint=hint)


def _sight(view: _View) -> np.ndarray:
    """Return unit directions (F, 3) from the camera to the person. Frames without keypoints get the mean direction."""
    total = np.maximum(view.weight.sum(axis=1), 1e-9)[:, None]
    middle = np.einsum("fl,fla->fa", view.weight, np.nan_to_num(view.image)) / total
    seen = view.weight.sum(axis=1) > 0
    middle = np.where(seen[:, None], middle, middle[seen].mean(axis=0))
    ray = np.concatenate([middle, np.ones((len(middle), 1))], axis=1)
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True) @ view.R)


def _reference(measurements: Measurements, body: Body, sight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return reference points (F, L, 3) to compare a network result with, and their variances along the line of sight.

    They are the lifted pose for one camera, and the triangulated points for several cameras.
    """
    source = measurements.source
    if isinstance(source, OneCamera):
        names = body.layout.recorded.joints
        bones = [body.layout.joints[j] for j in np.argmax(measurements.landmarks.weights, axis=1)]
        columns = [names.index(bone) if bone in names else 0 for bone in bones]
        points = np.asarray(to_numpy(source.lifted.positions))
        return points, source.open.sight_sigma_m[:, columns] ** 2
    covariance = np.where(measurements.located[..., None, None], measurements.covariance, 0.0)
    return measurements.points, np.einsum("fa,flab,fb->fl", sight, covariance, sight)


def deviations(
    points: np.ndarray, view: _View, sight: np.ndarray, other: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the deviations (L, 2) of a result's points across and along the line of sight in metres.

    The first deviation is the distance of the points from their viewing rays. The second is their distance along the
    line of sight from the reference points ``other``, corrected for the ``variance`` of these points. The second
    deviation is at least the first one times the ratio of the jitter along and across the line of sight. Also return
    factors (L,) for the precision of the reference points. A factor is below 1 if the errors of a reference point are
    larger than its ``variance``.
    """
    weight = np.where(np.isfinite(points).all(-1), view.weight, 0.0)
    filled = np.nan_to_num(points)
    shift = place_before_camera(filled, view.image, weight)
    placed = filled + shift[:, None]
    off = placed[..., :2] - view.image * placed[..., 2:]
    across = _spread(np.where(weight[..., None] > 0, off, np.nan))
    whole = float(np.median(across[np.isfinite(across)])) if np.isfinite(across).any() else FITS_M
    across = np.maximum(np.where(np.isfinite(across), across, whole), LEAST_SIGMA_M)
    world = np.where(np.isfinite(points).all(-1)[..., None], points, np.nan) @ view.R
    apart = world - other
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        apart = apart - np.nanmedian(apart, axis=1, keepdims=True)
        jitter = world[:-2] - 2.0 * world[1:-1] + world[2:]
        jitter = jitter - np.nanmedian(jitter, axis=1, keepdims=True)
        expected = np.nanmedian(np.where(np.isfinite(apart).all(-1), variance, np.nan), axis=0)
    deep = _spread(np.einsum("fla,fa->fl", apart, sight)[..., None])
    along = np.einsum("fla,fa->fl", jitter, sight[1:-1])
    beside = jitter - along[..., None] * sight[1:-1, None]
    ratio = _spread(along[..., None]) / np.maximum(_spread(beside) * np.sqrt(1.5), 1e-9)
    least = across * np.clip(np.where(np.isfinite(ratio), ratio, 1.0), 1.0, 3.0)
    apart2, stated = np.nan_to_num(deep) ** 2, np.maximum(np.nan_to_num(expected), 1e-12)
    deep = np.sqrt(np.maximum(np.nan_to_num(deep) ** 2 - DOUBTED**2 * np.nan_to_num(expected), 0.0))
    deep = np.maximum(deep, least)
    return np.stack([across, deep], axis=-1), np.minimum(1.0, stated / np.maximum(apart2 - deep**2, stated))


def _spread(values: np.ndarray) -> np.ndarray:
    """Return robust standard deviations (L,) about zero of values (F, L, n), NaN for points without values."""
    rows = np.moveaxis(values, 1, 0).reshape(values.shape[1], -1)
    found = np.full(len(rows), np.nan)
    for number, row in enumerate(rows):  # over points
        known = row[np.isfinite(row)]
        if len(known):
            found[number] = 1.4826 * np.median(np.abs(known))
    return found


def _note(match: _Match, view: _View, sigma: np.ndarray, result: StartingResult) -> Diagnostic:
    across, deep = 1000.0 * np.median(sigma, axis=0)
    return diagnostic(
        "other_body_read",
        result="measured",
        cameras=[view.name],
        program=match.person.program,
        file=Path(result.file).name,
        across=across,
        deep=deep,
        reason=f" The frames were matched: {match.reason}" if match.reason else "",
    )
