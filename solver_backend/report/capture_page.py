"""Write a page about a capture before the solve: cameras, person, floor and corrections."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import INLIER_SIGMAS, triangulate
from solver_backend.exchange.diagnostics import warnings_in
from solver_backend.exchange.outputs import write_text
from solver_backend.geometry.arrays import quantile
from solver_backend.report.checks import by_gravity, capture_diagnostics
from solver_backend.report.markup import Tile, facts, heat_table, number, section, text, tiles
from solver_backend.report.page import page_of
from solver_backend.report.plots import plan, space_drawing, strip_plot
from solver_backend.report.sections import diagnostics_section
from solver_backend.report.statistics import detected_share, located_share, seen_by_views, share
from solver_backend.types import Capture

MOST_FRAMES = 400  # Maximum number of frames triangulated for the page, spread over the take.


def write_capture_report(path: Path | str, capture: Capture, *, overwrite: bool = False) -> Path:
    """Write a self-contained HTML page about a capture, completely or not at all."""
    return write_text(path, capture_html(capture), overwrite=overwrite)


def capture_html(capture: Capture) -> str:
    """Return the report page about a capture as HTML."""
    rows = np.unique(np.linspace(0, capture.num_frames - 1, min(capture.num_frames, MOST_FRAMES)).astype(int))
    views = _shared_views(capture, rows)
    found = by_gravity(capture_diagnostics(capture))
    headline = tiles(_tiles(capture, views, len(list(warnings_in(found)))))
    body = [
        diagnostics_section(found, capture.fps or 1.0),
        _space_section(capture, views, rows),
        _agreement_section(capture, views),
        section("Files", facts([("source", source) for source in capture.sources]), "", "files"),
    ]
    body = body if capture.sources else body[:-1]
    whose = f", {capture.person}" if capture.person else ""
    return page_of(f"Capture {text(capture.name + whose)}", text(_subtitle(capture)), headline + "".join(body))


class _SharedViews(NamedTuple):
    points: np.ndarray
    seen: np.ndarray
    agrees: np.ndarray
    off_px: np.ndarray


def _shared_views(capture: Capture, rows: np.ndarray) -> _SharedViews | None:
    """Triangulate the given frames (N,) of a capture.

    Returns:
        Points (N, K, 3), and for the views (C, N, K) masks of detections and of inliers, and residuals in pixels.
        None for a single view.
    """
    if (several := capture.several_views) is None:
        return None
    cameras, keypoints = several[0], several[1].at(rows)
    found = triangulate(cameras, keypoints.xy, keypoints.confidence)
    points = np.asarray(found.points)
    seen = (keypoints.confidence > 0) & np.isfinite(points).all(-1)
    off = np.linalg.norm(project(cameras, points) - keypoints.xy, axis=-1)
    return _SharedViews(points, seen, seen & np.asarray(found.inliers), np.where(seen, off, np.nan))


def _tiles(capture: Capture, views: _SharedViews | None, warnings: int) -> list[Tile]:
    found: list[Tile] = []
    if views is not None:
        agreement = float(share(views.agrees, views.seen, (0, 1, 2)))
        level = "good" if agreement >= 90 else "look" if agreement >= 75 else "bad"
        found.append(Tile("View agreement", number(agreement, 0), "%", "of detections match the other views", level))
        middle = float(quantile(views.off_px.ravel(), 0.5, axis=0))
        found.append(Tile("Distance between views", number(middle), "px", "median of all detections"))
    located = located_share(capture)
    if located is not None:
        found.append(Tile(seen_by_views(capture), number(100 * float(located.mean()), 0), "%", "of the keypoints"))
    if capture.markers is not None:
        known = np.isfinite(capture.markers.positions).all(-1)
        found.append(Tile("Markers seen", number(100 * float(known.mean()), 0), "%", "of all markers and frames"))
    people = max(len(capture.people), 1)
    found.append(Tile("People", str(people), "", capture.person or "one person"))
    found.append(Tile("Warnings", str(warnings), "", "in the list below", "look" if warnings else "good"))
    return found


def _space_section(capture: Capture, views: _SharedViews | None, rows: np.ndarray) -> str:
    if views is not None:
        assert capture.keypoints is not None
        points, names = views.points, capture.keypoints.joint_set
    elif capture.markers is not None:
        points, names = np.asarray(capture.markers.positions)[rows], None
    else:
        points, names = np.empty((0, 0, 3)), None
    drawing = space_drawing(capture.cameras, points, names)
    if not drawing:
        return ""
    known = points[np.isfinite(points).all(-1)]
    values: list[tuple[str, object]] = []
    if len(known):
        low, high = (quantile(known, q, axis=0) for q in (0.01, 0.99))
        values.append(("lowest and highest point", f"{low[2]:.2f} and {high[2]:.2f} m"))
        values.append(("extent over the floor", f"{high[0] - low[0]:.1f} x {high[1] - low[1]:.1f} m"))
    if capture.cameras is not None:
        for name, (x, y, z) in zip(capture.cameras.names, capture.cameras.centres.tolist(), strict=True):
            values.append((f"camera {name}", f"{x:.2f}, {y:.2f}, {z:.2f} m"))
    with np.errstate(invalid="ignore"):
        known_rows = np.isfinite(points).all(-1)
        middle = np.where(known_rows[..., None], points, 0.0).sum(1) / np.maximum(known_rows.sum(1), 1)[:, None]
    way = middle[known_rows.any(1)] if len(points) else np.empty((0, 3))
    above = plan(capture.cameras, way[:, :2]) if len(way) else ""
    lead = (
        "The drawing shows the person at several times, from faint to strong, with the left side in blue and the "
        "right side in orange. It also shows the floor at z = 0 and each camera's view. The plan below shows the "
        "same from above, with the world's Y axis up. If the feet are off the floor or the person leans, the world "
        "axes may be wrong."
    )
    return section("Space", f'{drawing}<div class="pair">{above}{facts(values)}</div>', lead, "space")


def _agreement_section(capture: Capture, views: _SharedViews | None) -> str:
    seen = detected_share(capture)
    if seen is None or capture.cameras is None or capture.keypoints is None:
        return ""
    names, fps = capture.cameras.names, capture.keypoints.fps
    shown = f"<h3>Keypoints that each camera detected</h3>{strip_plot(_strips(names, seen), fps)}"
    lead = "The strips show each camera's detections over time. Full colour means all keypoints, and empty means none."
    if views is None:
        return section("Views", shown, lead, "views")
    frames = np.maximum(views.seen.sum(-1), 1)
    agrees = views.agrees.sum(-1) / frames
    rate = fps * views.seen.shape[1] / max(capture.num_frames, 1)
    table = _camera_table(names, views)
    lead += (
        f" Detections agree if they are within {INLIER_SIGMAS:g} standard deviations of the triangulated "
        "point. If a strip is always empty, the camera may have a wrong position, image size or name. If it is "
        "empty for a while, the camera may have been touched or have seen another person. Gaps in all strips "
        "suggest that the cameras did not start together."
    )
    shown = f"<h3>Detections that agree with the other views</h3>{strip_plot(_strips(names, agrees), rate)}{shown}"
    return section("Views", f"{shown}<h3>Camera by camera</h3>{table}", lead, "views")


def _strips(names: tuple[str, ...], values: np.ndarray) -> list[tuple[str, np.ndarray]]:
    return [(name, values[c]) for c, name in enumerate(names)]


def _camera_table(names: tuple[str, ...], views: _SharedViews) -> str:
    agreement = share(views.agrees, views.seen, (1, 2))
    off = np.array([[float(quantile(camera.ravel(), q, axis=0)) for q in (0.5, 0.9)] for camera in views.off_px])
    usual = max(float(np.nan_to_num(np.nanmedian(off[:, 0]))) if np.isfinite(off).any() else 0.0, 1e-9)
    values = np.concatenate([agreement[:, None], off], axis=1)
    tint = np.concatenate([(100 - agreement[:, None]) / 40, off / usual / [3.0, 9.0]], axis=1)
    return heat_table(values, names, ["agree, %", "error, px (median)", "error, px (90 %)"], strength=tint, unit="")


def _subtitle(capture: Capture) -> str:
    parts = [f"{len(capture.cameras)} cameras"] if capture.cameras is not None else []
    seconds = f" ({capture.num_frames / capture.fps:.1f} s)" if capture.fps else ""
    parts.append(f"{capture.num_frames} frames at {capture.fps:g} fps{seconds}")
    if capture.keypoints is not None:
        parts.append(capture.keypoints.joint_set.value)
    if capture.markers is not None:
        parts.append(f"{capture.markers.positions.shape[1]} markers")
    return ", ".join(parts)
