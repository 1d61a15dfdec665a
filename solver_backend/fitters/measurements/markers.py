"""Measure optical markers, and landmarks that a network estimates, without cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import LEAST_LIMB_MARKERS, LEAST_MARKERS, least_markers, name_markers
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import JobInvalid, MarkersUnknown, NoDetections, SubjectInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import LANDMARKS_JOINTS, LANDMARKS_NETWORK, SolveSettings
from solver_backend.fitters.measurements.views import LocatedPoints
from solver_backend.fitters.model.subject import PosedFrames, Subject
from solver_backend.fitters.problem import Measurements, seen_frames
from solver_backend.geometry.arrays import Array, constant
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types import Capture, JointSet, MarkerCloud, MarkerSubject, Motion

SIGMA_M = 0.01  # Deviation per axis of a marker relative to the body, due to sliding skin and unknown placement.


SMALLEST_M = 0.55
"""Smallest extent in metres of a whole person's points, in the frame with the largest extent. Faces, hands and props
are smaller. Small children and people who crouch for a whole take are larger. Chosen by hand."""
UNIT_M = 0.01  # Smaller extents indicate a wrong unit, such as metres read as millimetres.
RIGID_M, TURNED = 0.005, 0.1
"""Largest change in metres of distances in a rigid body, and smallest relative change of the points' second moments
that shows that it rotates. A person who stands still while being carried does not rotate."""
_LOOKED_AT, _LEAST_FRAMES, _MOST_RIGID = 200, 10, 20  # Most and fewest frames compared, most points in a rigid body.


def no_person_in(points: np.ndarray) -> str:
    """Return the reason why points (F, N, 3) in metres cannot show a whole person, or "" if they can.

    The reason is that the points are too close together in every frame, or move as one rigid body. Rigidity is tested
    with sorted distances in the frames with the most points, so that swapped tracks do not matter.
    """
    seen = np.isfinite(points).all(-1)
    count = seen.sum(axis=1)
    if not (count > 1).any():
        return ""
    several, there = points[count > 1], seen[count > 1, :, None]
    low, high = np.where(there, several, np.inf).min(axis=1), np.where(there, several, -np.inf).max(axis=1)
    extent = float(np.linalg.norm(high - low, axis=-1).max())
    if extent < UNIT_M:
        return f"All points are within {1000 * extent:.1f} mm, so the unit is wrong"
    if extent < SMALLEST_M:
        return f"All points are within {extent:.2f} m, like the markers of a face, a hand or a prop"
    frames = np.flatnonzero(count == count.max())
    if count.max() > _MOST_RIGID or len(frames) < _LEAST_FRAMES:
        return ""
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, _LOOKED_AT).astype(int))]
    sets = points[frames][seen[frames]].reshape(len(frames), -1, 3)
    apart = np.linalg.norm(sets[:, :, None] - sets[:, None], axis=-1)[:, *np.triu_indices(sets.shape[1], 1)]
    centred = sets - sets.mean(axis=1, keepdims=True)
    moments = np.einsum("fna,fnb->fab", centred, centred)
    turned = np.linalg.norm(moments - moments[0], axis=(1, 2)).max() / np.trace(moments[0])
    if turned > TURNED and np.ptp(np.sort(apart, axis=1), axis=0).max() < RIGID_M:
        return f"The {sets.shape[1]} points move as one rigid body"
    return ""


def known_markers_of(cloud: MarkerCloud, own: Mapping[str, str] = MappingProxyType({})) -> MarkerCloud:
    """Select the markers whose labels are in a known layout or have a user-defined location.

    Raises:
        MarkersUnknown: there are no labels, or fewer than ``least_markers`` labels are known.
    """
    labels = _require_labels(cloud)
    names = name_markers(labels, own)
    if len(names.known) < least_markers(names.known.values()):
        read = [label for label in labels if label not in names.virtual]
        words = load_layouts().words
        if not names.known and (reason := no_person_in(cloud.positions)):
            hint = "Use markers on a body, or on an arm or leg with labels from a layout. Faces cannot be solved."
            raise MarkersUnknown(f"{reason}. There is no body to solve.", where="markers", hint=hint)
        sideless = [label for label in names.unknown if words.lacks_side(names.affixes.bare(label))]
        hint = "Label the markers according to a layout such as Plug-in Gait, or add markers."
        if len(labels) >= LEAST_MARKERS:
            hint = f"Define {LEAST_MARKERS} or more marker positions with `markers layout`, and solve with --layout."
        if sideless:
            hint = (
                f"Labels name a limb without its side: {_listed(sideless)}. Define its marker positions "
                "(such as LELB, RWRA) with `markers layout`, and solve with --layout."
            )
        message = (
            f"A body needs {LEAST_MARKERS} markers with labels from a known layout, and a single arm or leg needs "
            f"{LEAST_LIMB_MARKERS}. Of the {len(labels)} labels, {len(names.known)} are known: "
            f"{_listed(list(names.known))}. All labels: {_listed(read)}."
        )
        if names.virtual:
            message += f" Ignored as computed points: {_listed(list(names.virtual))}."
        raise MarkersUnknown(message, where="markers", hint=hint)
    return cloud.columns([i for i, label in enumerate(labels) if label in names.known])


def measure_markers(
    cloud: MarkerCloud, body: Body, like: Array, sigma_m: float = SIGMA_M, own: Mapping[str, str] = MappingProxyType({})
) -> Measurements:
    """Prepare labelled markers as measurements of a body.

    Args:
        cloud: markers with labels in known layouts (see ``LayoutFile.place_of``).
        sigma_m: standard deviation of a marker relative to the body per axis, in metres.
        own: user-defined locations, see ``name_markers``.

    Raises:
        MarkersUnknown: labels are missing, repeated or not in a known layout.
        NoDetections: no frame shows enough markers to place a body.
    """
    landmarks = marker_landmarks(body, _places(cloud, own))
    return measured_at(cloud, landmarks, like, np.full(len(landmarks), sigma_m))


def measured_at(cloud: MarkerCloud, landmarks: Landmarks, like: Array, sigma_m: np.ndarray) -> Measurements:
    """Prepare markers with known landmarks as measurements (see ``measure_markers``).

    The tracker's noise is added to the variance: covariances Σ give ``σ_marker² 1 + Σ``, and residuals give
    ``σ_marker² + residual²``. ``sigma_m`` are the (L,) standard deviations of markers relative to the body per axis, in
    metres.
    """
    points, located = _located(cloud.positions, "markers")
    noise = np.zeros((*points.shape, 3)) if cloud.covariance is None else np.nan_to_num(cloud.covariance)
    if cloud.covariance is None:
        own = 0.0 if cloud.residual is None else np.nan_to_num(np.maximum(cloud.residual, 0.0)) ** 2
        term = _term(points, located / (sigma_m**2 + own), like)
    else:
        term = PositionTerm.of(points, noise + (sigma_m**2)[:, None, None] * np.eye(3), like)
    sigma_mm = [round(1000 * float(value), 3) for value in sigma_m]
    provenance = {"markers": list(landmarks.names), "sigma_mm": sigma_mm}
    source = LocatedPoints.of(points, cloud.labels)
    return Measurements(landmarks, points, noise, term, cloud.fps, source, provenance=provenance)


def _located(points: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    points = np.asarray(points, dtype=np.float64)
    located = np.isfinite(points).all(-1)
    points = np.where(located[..., None], points, np.nan)
    if not seen_frames(points).any():
        raise NoDetections(f"No frame has enough {what} to place a body.", hint="Choose another recording.")
    return points, located


def _term(points: np.ndarray, weight: np.ndarray, like: Array) -> PositionTerm:
    filled = np.where(np.isfinite(points), points, 0.0)
    return PositionTerm(constant(filled, like), constant(weight, like))


def assign_person(measured: Measurements, subject: Subject, sigma_m: np.ndarray) -> Measurements:
    """Add a calibrated person, and the person's marker deviations (L,), to the measurements."""
    assert isinstance(measured.source, LocatedPoints)
    return replace(measured, known_person=subject, source=replace(measured.source, sigma_m=sigma_m))


def _require_labels(cloud: MarkerCloud) -> tuple[str, ...]:
    if cloud.labels is None:
        raise MarkersUnknown("The markers have no labels.", hint="Label them in the program that recorded them.")
    return cloud.labels


def _places(cloud: MarkerCloud, own: Mapping[str, str]) -> tuple[str, ...]:
    labels, layouts = _require_labels(cloud), load_layouts()
    names = name_markers(labels, own)
    if unknown := sorted({label.rpartition(":")[2] for label in (*names.unknown, *names.virtual)}):
        message = f"No known layout contains the marker{'s' if len(unknown) > 1 else ''} {', '.join(unknown)}."
        raise MarkersUnknown(message, hint=f"Known markers: {', '.join(sorted(set(layouts.names.values())))}.")
    if len(names.known) < len(labels):
        taken = [names.known.get(label) or layouts.place_of(label) for label in labels]
        twice = sorted({str(place) for place in taken if taken.count(place) > 1})
        raise MarkersUnknown(f"Labels occur more than once: {', '.join(twice)}.", hint="Use unique names.")
    return tuple(names.known[label] for label in labels)


def _listed(labels: Sequence[str], most: int = 12) -> str:
    more = f" and {len(labels) - most} others" if len(labels) > most else ""
    return (", ".join(labels[:most]) or "none") + more


def measure_landmarks(
    landmarks: Landmarks, points: np.ndarray, fps: float, like: Array, sigma_m: float = SIGMA_M
) -> Measurements:
    """Prepare measurements from landmark positions (F, L, 3) in metres, NaN where missing.

    Raises:
        NoDetections: no frame shows enough landmarks to place a body.
    """
    points, located = _located(points, "landmarks")
    term, noise = _term(points, located * sigma_m**-2, like), np.zeros((*points.shape, 3))
    provenance = {"landmarks": list(landmarks.names), "sigma_mm": round(1000 * sigma_m, 3)}
    source = LocatedPoints.of(points, landmarks.names)
    return Measurements(landmarks, points, noise, term, fps, source, provenance=provenance)


MOTION_SIGMA_M = 0.02  # Deviation of a pose from the motion's, large enough for poses set by hand to dominate.
YIELDING_S = 0.25  # Seconds around a pinned pose without measurements, because the earlier motion was wrong there.
_LANDMARKS = JointSet.HALPE_26


def measure_motion(body: Body, motion: Motion, pinned: Sequence[int], like: Array) -> Measurements:
    """Prepare the body points of an earlier motion as measurements, except near pinned frames.

    Raises:
        MotionInvalid: the motion is for another body or layout.
    """
    motion.require_body(body.id, body.layout.recorded, where="resolve")
    landmarks = keypoint_landmarks(body, _LANDMARKS)
    poses = PosedFrames.of_motion(motion, motion.transl)
    points = pose_landmarks(body, landmarks, motion.betas, poses.root, poses.local, poses.transl).points
    frames, reach = np.arange(motion.num_frames), YIELDING_S * motion.fps
    doubted = (np.abs(frames[:, None] - np.array(pinned, dtype=int)[None]) < reach).any(axis=1)
    measured = measure_landmarks(
        landmarks, np.where(doubted[:, None, None], np.nan, points), motion.fps, like, MOTION_SIGMA_M
    )
    subject = Subject.average(body, landmarks, like)
    return replace(measured, known_person=replace(subject, betas=constant(motion.betas, subject.betas)))


def measure_network_landmarks(
    cloud: MarkerCloud, body: Body, like: Array, *, joints: bool, progress: Progress = silent, network_file: str = ""
) -> Measurements:
    """Estimate landmarks in each frame with a network, and prepare them as measurements (thesis 5.2.2).

    ``network_file`` is as in ``chosen_network``.

    Raises:
        NoDetections, CaptureInvalid: no frame has enough points for a person, or a frame has too many points for the
            network.
        JobInvalid: ``joints`` are requested, but the network does not estimate all of them.
    """
    # Imported here because the network's tables are read on import, and other methods do not need them.
    from solver_backend.labelling.outputs import MARKERS
    from solver_backend.labelling.point_network import frame_landmarks
    from solver_backend.labelling.position_network import chosen_network

    network, markers = chosen_network(network_file), marker_landmarks(body, MARKERS)
    landmarks = Landmarks.joined((markers, keypoint_landmarks(body, JointSet.SMPL_24))) if joints else markers
    points = frame_landmarks(cloud.positions, network, progress)[:, : len(landmarks)]
    if joints and not np.isfinite(points[:, len(markers) :]).any():
        hint = f"Use --landmarks {LANDMARKS_NETWORK}, which uses only its markers."
        raise JobInvalid("The landmark network does not estimate all joints.", where=network_file, hint=hint)
    measured = measure_landmarks(landmarks, points, cloud.fps, like)
    return replace(measured, provenance={**measured.provenance, "landmark_network": network.sha256})


def measure_directly(
    capture: Capture, body: Body, like: Array, settings: SolveSettings, person: MarkerSubject | None, progress: Progress
) -> Measurements:
    """Prepare the network's landmarks in a marker recording as measurements.

    Raises:
        JobInvalid: the recording has no markers.
        SubjectInvalid: a calibrated person is given, which requires labels.
    """
    if capture.markers is None or capture.keypoints is not None:
        message = f"The landmarks '{settings.landmarks}' need a marker recording."
        raise JobInvalid(message, where=capture.name, hint="Omit --landmarks.")
    if person is not None:
        message = "A calibrated person cannot be combined with network landmarks."
        raise SubjectInvalid(message, where=capture.name, hint="Specify the shape with --betas, or omit --landmarks.")
    joints = settings.landmarks == LANDMARKS_JOINTS
    return measure_network_landmarks(
        capture.markers, body, like, joints=joints, progress=progress, network_file=settings.network
    )
