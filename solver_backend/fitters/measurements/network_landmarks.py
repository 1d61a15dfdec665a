"""Direct solving: the labelling network's markers and joints are what is measured, and no point needs a label."""

from __future__ import annotations

from dataclasses import replace

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import JobInvalid, SubjectInvalid
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import LANDMARKS_JOINTS, SolveSettings
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.landmarks import measure_landmarks
from solver_backend.geometry.arrays import Array
from solver_backend.types import Capture, MarkerCloud, MarkerSubject


def measure_network_landmarks(
    cloud: MarkerCloud, body: Body, like: Array, *, joints: bool, progress: Progress = silent
) -> Measurements:
    """Return what the network has for each frame of a cloud, labelled or not (l_est of thesis 5.2.2).

    Args:
        cloud: F frames of points in any order.
        body: whose landmarks they are.
        like: array that sets kind, type and device.
        joints: its 24 joints too, beside its 53 markers.
        progress: called as frames are read.

    Raises:
        NoDetections, CaptureInvalid: too few points for a person, or too many to compare.
    """
    # Its tables are read as these are imported: other methods do without.
    from solver_backend.labelling.frame_landmarks import frame_landmarks
    from solver_backend.labelling.outputs import MARKERS
    from solver_backend.labelling.point_network import load_network

    network, markers = load_network(), marker_landmarks(body, MARKERS)
    landmarks = Landmarks.joined((markers, keypoint_landmarks(body, JointSet.SMPL_24))) if joints else markers
    points = frame_landmarks(cloud.positions, network, progress)[:, : len(landmarks)]
    measured = measure_landmarks(landmarks, points, cloud.fps, like)
    return replace(measured, provenance={**measured.provenance, "landmark_network": network.sha256})


def measure_directly(
    capture: Capture, body: Body, like: Array, settings: SolveSettings, person: MarkerSubject | None, progress: Progress
) -> Measurements:
    """Return what the network has for the frames of a recording of markers.

    Args:
        capture: with markers.
        body: whose landmarks they are.
        like: array that sets kind, type and device.
        settings: name which of them.
        person: who is known, if anybody.
        progress: called as frames are read.

    Raises:
        JobInvalid: the recording is none of markers.
        SubjectInvalid: a person is known, by markers that have labels.
        NoDetections, CaptureInvalid: as of ``measure_network_landmarks``.
    """
    if capture.markers is None or capture.keypoints is not None:
        raise JobInvalid(
            f"The landmarks '{settings.landmarks}' are read from a recording of markers, which this is not.",
            where=capture.name, hint="Leave --landmarks out.",
        )  # fmt: skip
    if person is not None:
        raise SubjectInvalid(
            "A calibrated person cannot be combined with a network's landmarks.",
            where=capture.name, hint="Give the shape by --betas, or leave --landmarks out.",
        )  # fmt: skip
    joints = settings.landmarks == LANDMARKS_JOINTS
    return measure_network_landmarks(capture.markers, body, like, joints=joints, progress=progress)
