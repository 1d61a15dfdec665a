"""Calibrate cameras from points clicked in their pictures, some of them with known places."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import BodySightings, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import Lens, build_cameras, planar_pose
from solver_backend.camera_calibration.extrinsics.two_views import (
    CalibratedCameras,
    point_bodies,
    resected_pose,
    result_of,
)
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged
from solver_backend.exchange.plausible import FARTHEST_PX
from solver_backend.io.files import read_text
from solver_backend.types import Cameras

CLICK_SIGMA_PX = 1.5
"""Standard deviation of a click, in px."""
PLACE_SIGMA_M = 0.003
"""Standard deviation of a measured position, in metres."""
FLAT = 0.02
"""Points are in a plane if they leave it by less than this share of their spread. Chosen by hand."""


@dataclass(frozen=True)
class Clicks:
    """Clicked points."""

    px: dict[str, dict[str, tuple[float, float]]]
    """Pixels by camera and point."""
    places: dict[str, tuple[float, float, float]]
    """Known places in metres by point."""


def read_clicks(path: Path) -> Clicks:
    """Read a table with ``point,camera,x,y`` per click and ``point,world,x,y,z`` per known place.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: a row has too few fields or no numbers.
    """
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
                raise ValueError("no place and no pixel")
            if fields[1] == "world":
                x, y, z = values
                places[fields[0]] = x, y, z
            else:
                u, v = values
                px.setdefault(fields[1], {})[fields[0]] = u, v
        except (ValueError, IndexError) as error:
            message = f"Line {number} is not point,camera,x,y or point,world,x,y,z."
            raise FileDamaged(message, where=str(path)) from error
    return Clicks(px, places)


def calibrate_by_points(clicks: Clicks, lenses: Mapping[str, Lens]) -> CalibratedCameras:
    """Return cameras in the world of the known points. Other points take part if two cameras see them.

    Args:
        clicks: at least four known points per camera, or six that are not in one plane.
        lenses: lens of each camera.

    Raises:
        CalibrationInvalid: a camera sees too few known points or has no lens, or the points are in a line.
    """
    names = tuple(clicks.px)
    if len(names) < 2:
        raise CalibrationInvalid(f"Points were clicked in {len(names)} pictures; two cameras are needed.")
    rng = np.random.default_rng(0)
    poses = []
    for name in names:
        if name not in lenses:
            raise CalibrationInvalid("The camera has no lens.", where=f"camera {name}", hint="Give it with --lenses.")
        poses.append(_pose(name, clicks, lenses[name], rng))
    R, t = np.stack([R for R, _ in poses]), np.stack([t for _, t in poses])
    cameras = build_cameras(names, [lenses[name] for name in names], R, t)
    xy, known = click_tables(cameras, clicks)
    sigma = np.full(xy.shape[:2], CLICK_SIGMA_PX)
    bodies, seen, used = point_bodies(cameras, xy, sigma, known, PLACE_SIGMA_M)
    unknowns = Unknowns(np.ones(len(names), bool))
    found = adjust(cameras, bodies, seen, unknowns, robust_scale=3.0, gauge=0)
    points, count = _points_of(clicks), int(np.isfinite(known).all(-1).sum())
    far = _far_clicks(found.error, seen, names, [points[i] for i in used])
    note = diagnostic("calibration_evidence", evidence="clicks", count=len(used), known=count)
    return replace(result_of("points", found), findings=far, notes=(note,))


def _points_of(clicks: Clicks) -> list[str]:
    return sorted({p for by_point in clicks.px.values() for p in by_point})


def click_tables(cameras: Cameras, clicks: Clicks) -> tuple[np.ndarray, np.ndarray]:
    """Return the clicks (C, P, 2) in px and the places (P, 3) in metres, NaN where there is none."""
    points, nowhere = _points_of(clicks), (np.nan, np.nan, np.nan)
    xy = [[clicks.px.get(name, {}).get(p, nowhere[:2]) for p in points] for name in cameras.names]
    return np.array(xy).reshape(len(cameras), -1, 2), np.array([clicks.places.get(p, nowhere) for p in points])


def _pose(name: str, clicks: Clicks, lens: Lens, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a camera's pose by known points, by a homography if they are in a plane."""
    seen = [p for p in clicks.px[name] if p in clicks.places]
    world = np.array([clicks.places[p] for p in seen]).reshape(-1, 3)
    px = np.array([clicks.px[name][p] for p in seen]).reshape(-1, 2)
    xy = undistort(lens.as_camera(), px[None])[0]
    if not np.isfinite(xy).all():
        first = seen[int(np.argmin(np.isfinite(xy).all(-1)))]
        message = f"The point {first} was clicked where the lens shows nothing."
        hint = "Check that the lenses are those of these cameras."
        raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
    middle = world.mean(0) if len(world) else np.zeros(3)
    spread, axes = np.linalg.svd(world - middle, full_matrices=True)[1:] if len(world) > 2 else (np.zeros(3), np.eye(3))
    flat = spread[2] < FLAT * spread[0]
    least = 4 if flat else 6
    if len(seen) < least or spread[1] < FLAT * spread[0] or spread[0] == 0:
        shape = "in a plane" if flat else "not in a plane"
        count = f"{len(seen)} points with known places were clicked"
        message = f"{count}, {shape}; {least} that are not in a line are needed."
        hint = "Click more known points, spread over the whole picture and over different depths."
        raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
    if not flat:
        R, t, _ = resected_pose(world, xy, 3.0 * CLICK_SIGMA_PX / float(lens.K[0, 0]), rng)
        return R, t
    axes = axes * np.array([[1.0], [1.0], [np.sign(np.linalg.det(axes))]])
    R, t = planar_pose((world - middle) @ axes[:2].T, xy)
    return R @ axes, t - R @ axes @ middle


def _far_clicks(
    error: np.ndarray, seen: BodySightings, names: tuple[str, ...], points: list[str]
) -> tuple[Diagnostic, ...]:
    """Report each click that is far from where the others expect it."""
    far = np.linalg.norm(error, axis=-1)
    bar = max(6.0 * CLICK_SIGMA_PX, 5.0 * float(np.median(far)))
    return tuple(
        diagnostic("click_far", cameras=[names[seen.camera[i]]], point=points[seen.body[i]], size=far[i])
        for i in np.flatnonzero(far > bar)
    )
