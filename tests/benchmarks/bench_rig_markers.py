"""Markers from three rendered infrared and depth sensors at 2 m (thesis 5.3.2): a walk and a choreography, 53 markers.

Figures are for single sensors and fused clouds (chi-square test, and the published 1 cm): the share of found markers of
which a sensor sees half, ghosts (points more than 3 cm from a free marker, or second points), and processor time per
picture. Then joints are solved: the network labels the markers, both takes calibrate the person, and the bundle solves
them with the clouds' covariances, with their size only (residuals) and without. Least squares and the published
noise-aware fit without calibration are compared. The bundle's ellipsoids are compared with the truth: shares of joints
inside the 50, 80 and 95 % ellipsoids. The walk needs the recordings (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from research.baselines.marker_fits import MoSh
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.label_first import labelled_capture
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.io.native.capture_file import read_capture
from solver_backend.sensors.acquisition.acquire import Acquisition
from solver_backend.sensors.chain import cloud_of
from solver_backend.sensors.devices.recorded import SensorFolder, open_folder
from solver_backend.sensors.fusion.moments import MarkerTracks, fuse
from solver_backend.synthesis.studio.data_set import SHOTS, make_data_set
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.types import Capture, Motion
from tests.benchmarks.metric import Metric
from tests.support.recordings import recordings_folder

FPS, FRAMES = 30, 80
WALK = "bvh_samples/cmu_mb2_02_01.bvh"
NEAR_M = 0.03
"""Distance in metres from every marker beyond which a point is a ghost."""
HALF_SEEN = 0.5
LEVELS = {0.5: 2.366, 0.8: 4.642, 0.95: 7.815}
"""Quantiles of the chi-square distribution with three degrees of freedom, by level."""
TIMED = 20  # Number of frames per take for measuring times.


@dataclass(frozen=True)
class Shot:
    """A rendered take and its truth."""

    folder: SensorFolder
    markers: np.ndarray
    """(F, 53, 3) marker positions in metres."""
    seen: np.ndarray
    """(C, F, 53) fraction of each marker that each sensor sees."""
    joints: np.ndarray
    """(F, 24, 3) joint positions in metres."""


def run() -> list[Metric]:
    """Film, measure, print."""
    with tempfile.TemporaryDirectory() as place:
        shots = filmed(Path(place))
        metrics = [*_single(shots), *_times(shots)]
        for kind in ("test", "radius"):
            metrics += _fused(shots, kind)
        return [*metrics, *_joints(shots)]


def filmed(place: Path) -> list[Shot]:
    """Render both takes."""
    spec = spec_of({
        "seed": 2, "fps": FPS, "frames": FRAMES, "motions": ["choreography", str(recordings_folder() / WALK)],
        "camera_arrays": ["azure_kinect_3"], "looks": ["suit"], "film": ["infrared", "depth"],
    })  # fmt: skip
    make_data_set(spec, place)
    found = []
    for path in sorted((place / SHOTS).iterdir()):
        clean = read_capture(path / "clean.npz")
        assert clean.markers is not None
        with np.load(path / "truth.npz") as truth:
            seen = truth["marker_seen"]
        found.append(Shot(open_folder(path), clean.markers.positions, seen, clean.truth["joints"]))
    return found


def _single(shots: list[Shot]) -> list[Metric]:
    error = []
    for shot in shots:
        for device in shot.folder.devices:
            acquisition = Acquisition(shot.folder.cameras, device.name)
            for frame in device.frames():
                found = acquisition(frame)
                points = found.points[np.isfinite(found.depth)]
                off = np.linalg.norm(points[:, None] - shot.markers[frame.number], axis=-1).min(1)
                error.append(off[off < NEAR_M])
    return [Metric("single_sensor_rms_mm", _rms_mm(np.concatenate(error)), "mm", rel_tol=0.1)]


def _fused(shots: list[Shot], kind: str) -> list[Metric]:
    errors, found, visible, ghosts, frames = [], 0, 0, 0, 0
    for shot in shots:
        cloud = cloud_of(shot.folder, clusters=kind).cloud
        for k, true in enumerate(shot.markers):
            points = cloud.positions[k][np.isfinite(cloud.positions[k]).all(-1)]
            off, which = _one_each(points, true)
            errors.append(off)
            ghosts += len(points) - len(which)
            seen = (shot.seen[:, k] >= HALF_SEEN).any(0)
            found, visible = found + int(seen[which].sum()), visible + int(seen.sum())
        frames += len(shot.markers)
    return [
        Metric(f"fused_{kind}_rms_mm", _rms_mm(np.concatenate(errors)), "mm", rel_tol=0.1),
        Metric(f"fused_{kind}_found", 100.0 * found / visible, "%", "higher", abs_tol=0.5, rel_tol=0.0),
        Metric(f"fused_{kind}_ghosts", 100.0 * ghosts / frames, "/100 f", abs_tol=0.7),
    ]


def _one_each(points: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances and markers of the points that are nearest to a marker. A marker has at most one point."""
    off = np.linalg.norm(points[:, None] - true, axis=-1)
    which, least = off.argmin(1), off.min(1)
    order = np.argsort(least)
    order = order[least[order] < NEAR_M]
    _, first = np.unique(which[order], return_index=True)
    kept = order[first]
    return least[kept], which[kept]


def _times(shots: list[Shot]) -> list[Metric]:
    """Return processor time per picture and per moment. Frames are read in advance and processed once untimed."""
    acquired, fused = [], []
    for shot in shots:
        finders = [Acquisition(shot.folder.cameras, device.name) for device in shot.folder.devices]
        streams = [device.frames() for device in shot.folder.devices]
        moments = [[next(stream) for stream in streams] for _ in range(TIMED)]
        tracks = MarkerTracks()
        for moment in moments:
            start = time.process_time()
            sightings = [finder(frame) for finder, frame in zip(finders, moment, strict=True)]
            between = time.process_time()
            tracks.update(fuse(sightings))
            acquired.append((between - start) / len(moment))
            fused.append(time.process_time() - between)
    picture, moment = 1e3 * float(np.median(acquired)), 1e3 * float(np.median(fused))
    return [
        Metric("acquisition_cpu_ms", picture, "ms", rel_tol=0.8),
        Metric("fusion_cpu_ms", moment, "ms", rel_tol=0.8),
        Metric("three_sensors_two_cores", 2e3 / (3 * picture + moment), "frames/s", "higher", rel_tol=0.5),
    ]


def _joints(shots: list[Shot]) -> list[Metric]:
    labelled = [
        labelled_capture(Capture("take", markers=cloud_of(shot.folder).cloud), always=True)[0] for shot in shots
    ]
    settings = SolveSettings()
    person = calibrate_person(labelled, settings)
    rows: dict[str, list[Motion]] = {
        name: _bundles(captures, settings)
        for name, captures in (
            ("bundle_calibrated", labelled),
            ("bundle_calibrated_residuals", [_without(capture, "covariance") for capture in labelled]),
            ("bundle_calibrated_no_residuals", [_without(capture, "covariance", "residual") for capture in labelled]),
        )
    }
    rows |= {
        "least_squares": [_least_squares(capture) for capture in labelled],
        "noise_aware": [solve(capture, SolveSettings(method="noise-aware")).motion for capture in labelled],
        "noise_aware_calibrated": [
            solve(capture, SolveSettings(method="noise-aware"), person=person).motion for capture in labelled
        ],
    }
    metrics = []
    for name, motions in rows.items():
        off = [
            np.linalg.norm(motion.joints[:, :22] - shot.joints[: motion.num_frames, :22], axis=-1)
            for motion, shot in zip(motions, shots, strict=True)
        ]
        each = "   ".join(f"{1e3 * float(part.mean()):5.2f}" for part in off)
        sys.stdout.write(f"  {name:<32} joints, mean mm a take: {each}\n")
        metrics.append(Metric(f"joints_{name}_mm", 1e3 * float(np.concatenate(off).mean()), "mm", rel_tol=0.15))
        if name.startswith("bundle"):
            shares = _inside(shots, motions)
            said = "   ".join(f"{100 * part:.0f} %: {100 * share:5.1f}" for part, share in shares.items())
            sys.stdout.write(f"  {name:<32} joints inside ellipsoids of {said}\n")
            metrics += [
                Metric(f"ellipsoids_{name}_{100 * part:.0f}", 100 * share, "%", "higher", abs_tol=5.0, rel_tol=0.0)
                for part, share in shares.items()
            ]
    return metrics


def _bundles(captures: list[Capture], settings: SolveSettings) -> list[Motion]:
    person = calibrate_person(captures, settings)
    return [solve(capture, settings, person=person).motion for capture in captures]


def _inside(shots: list[Shot], motions: list[Motion]) -> dict[float, float]:
    """Return the share of joints inside the ellipsoids of each level: ``eᵀ Σ⁻¹ e`` below the chi-square quantile."""
    squares = []
    for shot, motion in zip(shots, motions, strict=True):
        assert motion.joint_covariance is not None
        covariance = unpacked(np.asarray(motion.joint_covariance[:, :22], dtype=np.float64))
        error = motion.joints[:, :22] - shot.joints[: motion.num_frames, :22]
        squares.append(np.einsum("fji,fjik,fjk->fj", error, np.linalg.inv(covariance), error).ravel())
    return {part: float((np.concatenate(squares) < limit).mean()) for part, limit in LEVELS.items()}


def _least_squares(capture: Capture) -> Motion:
    motion = MoSh().solve(capture).motion
    assert motion is not None
    return motion


def _without(capture: Capture, *fields: str) -> Capture:
    """Return the capture without some fields about its points' errors."""
    assert capture.markers is not None
    return replace(capture, markers=replace(capture.markers, **dict.fromkeys(fields)))


def _rms_mm(metres: np.ndarray) -> float:
    return 1e3 * float(np.sqrt((metres**2).mean()))
