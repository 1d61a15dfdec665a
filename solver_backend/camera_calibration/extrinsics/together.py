"""Calibrate cameras from clicked points, alone or together with board footage and a take."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment import bundle
from solver_backend.camera_calibration.adjustment.bundle import Adjusted, Bodies, BodySightings, Held, Unknowns
from solver_backend.camera_calibration.adjustment.lens import Lens, build_cameras, lens_of, planar_pose
from solver_backend.camera_calibration.boards.board import Board, BoardSighting
from solver_backend.camera_calibration.extrinsics import person_session, two_views
from solver_backend.camera_calibration.extrinsics.board_session import board_world, placed_boards, poses_seen
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged, NoDetections
from solver_backend.exchange.plausible import FARTHEST_PX
from solver_backend.geometry.alignment import nearest_rotation, umeyama
from solver_backend.io.files import read_text
from solver_backend.types import Cameras, Keypoints2D

CLICK_SIGMA_PX = 1.5  # Standard deviation of a clicked position, in px.
FLAT = 0.02  # Largest deviation of points in a plane, relative to their spread. Chosen by hand.


@dataclass(frozen=True)
class Clicks:
    """Pixels of clicked points, and the known positions of some of these points."""

    px: dict[str, dict[str, tuple[float, float]]]  # Pixels for each camera and point.
    places: dict[str, tuple[float, float, float]]  # Known position of each point in metres.


def read_clicks(path: Path) -> Clicks:
    """Read a table of clicked points (``point,camera,x,y``) and known positions (``point,world,x,y,z``)."""
    px: dict[str, dict[str, tuple[float, float]]] = {}
    places: dict[str, tuple[float, float, float]] = {}
    try:
        rows = list(csv.reader(read_text(path).splitlines()))
    except csv.Error as error:
        raise FileDamaged(f"The file is not a table of points ({error}).", where=str(path)) from error
    for number, row in enumerate(rows, start=1):
        fields = [field.strip() for field in row]
        if not any(fields) or fields[0].startswith("#") or fields[:2] == ["point", "camera"]:
            continue
        try:
            values = [float(v) for v in fields[2:] if v]
            if not (np.abs(values) <= FARTHEST_PX).all():
                raise ValueError("a row contains no position and no pixel")
            if fields[1] == "world":
                x, y, z = values
                places[fields[0]] = x, y, z
            else:
                u, v = values
                px.setdefault(fields[1], {})[fields[0]] = u, v
        except (ValueError, IndexError) as error:
            message = f"Line {number} must have the form point,camera,x,y or point,world,x,y,z."
            raise FileDamaged(message, where=str(path)) from error
    return Clicks(px, places)


def calibrate_by_points(clicks: Clicks, lenses: Mapping[str, Lens]) -> CalibratedCameras:
    """Calibrate cameras from clicked points, in the world of the known positions.

    Points without a known position are used if two cameras see them.

    Args:
        clicks: per camera, at least four known points in a plane, or six that are not in a plane.
        lenses: lens of each camera.
    """
    names = tuple(clicks.px)
    if len(names) < 2:
        hint = "Click points in at least two cameras."
        raise CalibrationInvalid(f"Points were clicked in {len(names)} cameras, but two are needed.", hint=hint)
    rng = np.random.default_rng(0)
    for name in names:
        if name not in lenses:
            raise CalibrationInvalid("The lens is unknown.", where=f"camera {name}", hint="Specify it with --lenses.")
    R, t = map(np.stack, zip(*(_pose(name, clicks, lenses[name], rng) for name in names), strict=True))
    cameras = build_cameras(names, [lenses[name] for name in names], R, t)
    evidence = clicks_evidence(cameras, clicks)
    found = _adjusted(cameras, [evidence], Unknowns(np.ones(len(names), bool)), tolerance=1e-8)
    assert evidence.bodies.known is not None
    known = int(np.isfinite(evidence.bodies.known).all(-1).sum())
    note = diagnostic("calibration_evidence", evidence="clicks", count=len(evidence.labels), known=known)
    return replace(two_views.result_of("points", found), findings=_far_clicks(found, evidence.labels), notes=(note,))


def _points_of(clicks: Clicks) -> list[str]:
    return sorted({p for by_point in clicks.px.values() for p in by_point})


def click_tables(cameras: Cameras, clicks: Clicks) -> tuple[np.ndarray, np.ndarray]:
    """Return the clicks (C, P, 2) in px and the known positions (P, 3) of P points, NaN where missing."""
    points, nowhere = _points_of(clicks), (np.nan, np.nan, np.nan)
    xy = [[clicks.px.get(name, {}).get(p, nowhere[:2]) for p in points] for name in cameras.names]
    return np.array(xy).reshape(len(cameras), -1, 2), np.array([clicks.places.get(p, nowhere) for p in points])


def _pose(name: str, clicks: Clicks, lens: Lens, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Estimate a camera's pose from clicked points with known positions, which may lie in a plane."""
    seen = [p for p in clicks.px[name] if p in clicks.places]
    world = np.array([clicks.places[p] for p in seen]).reshape(-1, 3)
    px = np.array([clicks.px[name][p] for p in seen]).reshape(-1, 2)
    xy = undistort(lens.as_camera(), px[None])[0]
    if not np.isfinite(xy).all():
        first = seen[int(np.argmin(np.isfinite(xy).all(-1)))]
        message = f"The point {first} was clicked outside the lens's image area."
        hint = "Check that the lenses belong to these cameras."
        raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
    middle = world.mean(0) if len(world) else np.zeros(3)
    spread, axes = np.linalg.svd(world - middle, full_matrices=True)[1:] if len(world) > 2 else (np.zeros(3), np.eye(3))
    flat = spread[2] < FLAT * spread[0]
    least = 4 if flat else 6
    if len(seen) < least or spread[1] < FLAT * spread[0] or spread[0] == 0:
        shape = "in a plane" if flat else "not in a plane"
        count = f"{len(seen)} points with known positions were clicked"
        message = f"{count}, {shape}. At least {least} that are not in a line are needed."
        hint = "Click more known points, spread over the whole image and over different depths."
        raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
    if not flat:
        R, t, _ = two_views.resected_pose(world, xy, 3.0 * CLICK_SIGMA_PX / float(lens.K[0, 0]), rng)
        return R, t
    axes = axes * np.array([[1.0], [1.0], [np.sign(np.linalg.det(axes))]])
    R, t = planar_pose((world - middle) @ axes[:2].T, xy)
    return R @ axes, t - R @ axes @ middle


def _far_clicks(found: Adjusted, points: tuple[int | str, ...]) -> tuple[Diagnostic, ...]:
    """Report each click that is far from the projection of its point."""
    far, seen, names = np.linalg.norm(found.error, axis=-1), found.seen, found.cameras.names
    bar = max(6.0 * CLICK_SIGMA_PX, 5.0 * float(np.median(far)))
    return tuple(
        diagnostic("click_far", cameras=[names[seen.camera[i]]], point=points[seen.body[i]], size=far[i])
        for i in np.flatnonzero(far > bar)
    )


LEAST_PLACES = 3  # Minimum number of known positions that define the world.


@dataclass(frozen=True)
class Evidence:
    """Observations from one source: a board, a person or clicked points."""

    name: str
    bodies: Bodies
    seen: BodySightings
    alike: float = 1.0  # Number of sightings with correlated errors. It reduces their weight.
    metric: bool = False  # True if the source determines the scale.
    labels: tuple[int | str, ...] = ()  # Frame numbers of the board's poses, or names of points.


def board_evidence(
    cameras: Cameras, board: Board, sightings: Sequence[Mapping[int, BoardSighting]], fps: float | None = None
) -> Evidence:
    """Collect a moving board's observations. In each frame, the camera that sees most points gives its initial pose."""
    poses = [poses_seen(board, seen, lens_of(cameras, c)) for c, seen in enumerate(sightings)]
    moments = tuple(sorted(set().union(*(p.keys() for p in poses))))
    if not moments:
        raise NoDetections(f"No camera sees the {board}.", hint="Check that --board describes the filmed board.")
    bodies, seen = placed_boards(board, sightings, poses, list(zip(cameras.R, cameras.t, strict=True)), moments, fps)
    return Evidence("board", bodies, seen, metric=True, labels=moments)


def person_evidence(cameras: Cameras, keypoints: Keypoints2D) -> Evidence:
    """Return the observations of one person's keypoints. Every keypoint of every frame becomes a separate point."""
    frames, xy, confidence = person_session.sample_person(keypoints, person_session.FINAL_FRAMES)
    bodies, seen, _ = two_views.point_bodies(cameras, xy, person_session.keypoint_sigma(confidence))
    return Evidence("person", bodies, seen, alike=float(min(person_session.FRAMES_ALIKE, len(frames))))


def clicks_evidence(cameras: Cameras, clicks: Clicks) -> Evidence:
    """Return the observations of clicked points, including their known positions."""
    xy, known = click_tables(cameras, clicks)
    bodies, seen, used = two_views.point_bodies(cameras, xy, np.full(xy.shape[:2], CLICK_SIGMA_PX), known)
    labels = tuple(_points_of(clicks)[i] for i in used)
    return Evidence("clicks", bodies, seen, metric=bool(np.isfinite(known).any()), labels=labels)


def in_world_of(clicks: Clicks, cameras: Cameras, *, with_scale: bool) -> Cameras:
    """Transform cameras to the world of the known positions. Without known positions, the cameras stay unchanged."""
    xy, known = click_tables(cameras, clicks)
    if not np.isfinite(known).any():
        return cameras
    located = two_views.intersected(cameras.R, cameras.t, undistort(cameras, xy))
    both = np.isfinite(located).all(-1) & np.isfinite(known).all(-1)
    spread = np.linalg.svd(known[both] - known[both].mean(0))[1] if both.sum() >= LEAST_PLACES else np.zeros(2)
    if spread[1] < 0.02 * max(float(spread[0]), 1e-9):
        count = f"{int(both.sum())} known positions are seen by two cameras"
        message = f"{count}. At least {LEAST_PLACES} that are not in a line are needed to set the world."
        raise CalibrationInvalid(message, hint="Click more points with known positions, or omit the positions.")
    scale, R, t = umeyama(located[both], known[both], with_scale=with_scale)
    return two_views.in_other_world(cameras, np.asarray(R), np.asarray(t), float(scale))


HELD_REACH_M = 3.0  # Distance in metres at which a held camera's rotation deviates as much as its centre.
CONTRADICTION = 2.0  # Factor by which the other sources must increase a camera's error to contradict a source.
LEAST_CONTRADICTION_PX = 3.0  # Smallest error that is reported. Smaller ones have no effect on a take.
WORST_SHARE = 0.6  # Smallest error growth that is reported, relative to the largest. A moved camera affects others.
FREEDOM = 1.2  # Correction of the residuals for the lost degrees of freedom, as in ``person_session``.
LEAST_SIGMA_PX = 0.05  # Smallest standard deviation of a source, in pixels. Chosen by hand.
_ROBUST = 3.0  # Residuals lose weight beyond this number of standard deviations. Chosen by hand.


def calibrate_together(
    start: Cameras, sources: Sequence[Evidence], *, hold_m: float | None = None, origin_frame: int | None = None
) -> CalibratedCameras:
    """Calibrate cameras jointly from several sources, such as a board, a person and clicks.

    The first adjustment assumes the expected noise of each source. The second one uses the noise of the residuals. The
    world is defined by the known positions, by the board at ``origin_frame``, or by the initial cameras.

    Args:
        start: C cameras close to the solution. If there are known positions, these define the world.
        hold_m: keep camera centres near their initial positions, with this standard deviation in metres.

    Raises:
        CalibrationInvalid: there is no source, a camera has no observations, or no camera sees the board at
            ``origin_frame``.

    References: Triggs et al. 2000; Foerstner 1979 (variance components).
    """
    if not sources:
        raise CalibrationInvalid("There are no observations to use.", hint="Provide a board, a take or clicked points.")
    unseen = set(range(len(start))) - set(np.concatenate([e.seen.camera for e in sources]).tolist())
    if unseen and hold_m is None:
        names = ", ".join(start.names[c] for c in sorted(unseen))
        raise CalibrationInvalid(f"There are no observations for {names}.", hint="Film a board or a person with them.")
    late = np.arange(len(start)) > 0 if any(e.seen.velocity is not None for e in sources) else None
    held = None if hold_m is None else Held(start, hold_m / HELD_REACH_M, hold_m)
    unknowns = Unknowns(np.ones(len(start), bool), delays=late, held=held)
    alone = [_by_camera(_adjusted(start, [e], unknowns), [e])[0] for e in sources] if len(sources) > 1 else []
    first = _adjusted(start, sources, unknowns)
    sigmas = _measured(first, sources)
    weighed = [
        replace(e, seen=replace(e.seen, sigma=e.seen.sigma * s * np.sqrt(e.alike)))
        for e, s in zip(sources, sigmas, strict=True)
    ]
    found = _adjusted(first.cameras, weighed, unknowns)
    errors = _measured(found, sources)
    words, notes = list[Diagnostic](), list[Diagnostic]()
    for e, before, after in zip(sources, alone, _by_camera(found, sources), strict=False):
        words += _contradictions(e.name, start.names, before, after)
    for e, s in zip(sources, errors, strict=True):
        figures = {"source": e.name, "count": len(e.seen.px), "size": s * float(np.median(e.seen.sigma))}
        notes.append(diagnostic("calibration_evidence", evidence="source", **figures))
    result = two_views.result_of("together", found, measured=True)
    result, where = _in_world(result, found, start, sources, hold_m is not None, origin_frame)
    if hold_m is not None:
        moved = np.linalg.norm(result.cameras.centres - start.centres, axis=1)
        for c in map(int, np.flatnonzero(moved > _ROBUST * hold_m)):
            figures = {"reference": "held", "unit": "mm", "size": 1000 * moved[c]}
            words.append(diagnostic("camera_off", cameras=[start.names[c]], **figures))
    return replace(result, findings=tuple(words), notes=(*notes, where))


def _adjusted(cameras: Cameras, sources: Sequence[Evidence], unknowns: Unknowns, tolerance: float = 1e-7) -> Adjusted:
    bodies, seen = _joined(sources)
    placed = bodies.known is not None and int(np.isfinite(bodies.known).all(-1).sum()) >= 3
    gauge = 0 if placed or unknowns.held is not None else 6 if any(e.metric for e in sources) else 7
    return bundle.adjust(cameras, bodies, seen, unknowns, robust_scale=_ROBUST, gauge=gauge, tolerance=tolerance)


def _joined(sources: Sequence[Evidence]) -> tuple[Bodies, BodySightings]:
    firsts = np.cumsum([0, *(len(e.bodies.t) for e in sources[:-1])])
    bodies = [e.bodies for e in sources]
    seen = [replace(e.seen, body=e.seen.body + first) for e, first in zip(sources, firsts, strict=True)]
    if any(part.known is not None for part in bodies):
        bodies = [part if part.known is not None else replace(part, known=np.nan * part.t) for part in bodies]
    if any(part.velocity is not None for part in seen):
        seen = [part if part.velocity is not None else replace(part, velocity=0.0 * part.px) for part in seen]
    return Bodies.concatenate(bodies), BodySightings.concatenate(seen)


def _errors(found: Adjusted, sources: Sequence[Evidence]) -> Iterator[tuple[Evidence, np.ndarray]]:
    ends = np.cumsum([len(e.seen.px) for e in sources])[:-1]
    return zip(sources, np.split(np.linalg.norm(found.error, axis=-1), ends), strict=True)


def _measured(found: Adjusted, sources: Sequence[Evidence]) -> list[float]:
    """Return the ratio of the measured errors to the expected standard deviations for each source."""
    factors = (FREEDOM * float(np.nanmedian(far / e.seen.sigma)) / 1.1774 for e, far in _errors(found, sources))
    return [max(s, LEAST_SIGMA_PX / float(e.seen.sigma.min())) for e, s in zip(sources, factors, strict=True)]


def _contradictions(source: str, names: Sequence[str], before: np.ndarray, after: np.ndarray) -> list[Diagnostic]:
    """Report cameras on which a source contradicts the other sources.

    ``before`` is the error (C,) of a calibration from this source alone, ``after`` the error of the joint calibration.
    """
    grown = np.nan_to_num(after - before)
    far = (after > np.maximum(CONTRADICTION * before, LEAST_CONTRADICTION_PX)) & (grown > WORST_SHARE * grown.max())
    found = []
    for c in map(int, np.flatnonzero(far)):
        figures = {"source": source, "after": after[c], "before": before[c]}
        found.append(diagnostic("observations_contradict", kind="source", cameras=[names[c]], **figures))
    return found


def _by_camera(found: Adjusted, sources: Sequence[Evidence]) -> list[np.ndarray]:
    """Return each source's median error (C,) per camera in px, NaN for cameras without observations."""
    return [bundle.median_by_camera(far, e.seen, len(found.cameras)) for e, far in _errors(found, sources)]


def _in_world(
    result: CalibratedCameras,
    found: Adjusted,
    start: Cameras,
    sources: Sequence[Evidence],
    held: bool,
    origin: int | None,
) -> tuple[CalibratedCameras, Diagnostic]:
    if any(e.bodies.known is not None and np.isfinite(e.bodies.known).any() for e in sources):
        return result, diagnostic("world_origin", source="places")
    if origin is not None:
        first = 0
        for e in sources:
            if e.name == "board":
                R, t, note = board_world(found.bodies, e.labels, origin, first)
                return two_views.moved_world(result, R, t), note
            first += len(e.bodies.t)
        raise CalibrationInvalid("--origin needs footage of a board.", hint="Add --footage, or omit --origin.")
    if held:
        return result, diagnostic("world_origin", source="held")
    metric, cameras = any(e.metric for e in sources), result.cameras
    spread = [float(np.linalg.norm(c.centres - c.centres.mean(0))) for c in (start, cameras)]
    scale = 1.0 if metric else spread[0] / max(spread[1], 1e-9)
    R = np.asarray(nearest_rotation((np.swapaxes(start.R, 1, 2) @ cameras.R).sum(0)))
    t = (start.centres - scale * cameras.centres @ R.T).mean(0)
    note = diagnostic("world_origin", source="start_scaled" if metric else "start")
    return two_views.moved_world(result, R, t, scale), note
