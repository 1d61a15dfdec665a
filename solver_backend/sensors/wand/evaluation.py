"""Evaluate a wand calibration and write its report page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from html import escape

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Adjusted
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras, moved_world, result_of
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.report.markup import Tile, facts, heat_table, number, section, text, tiles
from solver_backend.report.page import page_of
from solver_backend.sensors.wand.gamma import Ground
from solver_backend.sensors.wand.session import (
    LEAST_TOGETHER,
    WandCalibration,
    WandOptions,
    WandTask,
    adjusted,
    depth_scale,
    held_out,
    reprojection_px,
    triangulated,
)
from solver_backend.sensors.wand.views import LEAST_IN_CELL, Moments, WandInvalid, WandView, distances
from solver_backend.videos.sync.clocks import Clocks

MOST_PX = 8.0
"""Largest usable median reprojection error in pixels. Chosen by hand."""
GOOD_PX, LATE_S = 1.0, 0.001
"""Larger errors in pixels and delays in seconds are reported. Chosen by hand."""


def require_fit(found: Adjusted) -> None:
    """Refuse an adjustment with too large errors.

    Raises:
        WandInvalid: the median error is beyond ``MOST_PX``.
    """
    usual = float(np.nanmedian(np.linalg.norm(found.error, axis=-1)))
    if not usual < MOST_PX:
        message = f"What the sensors saw does not fit together: {usual:.0f} px off at the middle."
        hint = "Check that clocks agree (--trigger), lenses are of this mode, and only one wand was in sight."
        raise WandInvalid(message, where=", ".join(found.cameras.names), hint=hint)


def metric(found: Adjusted, moments: Moments, options: WandOptions) -> tuple[CalibratedCameras, float]:
    """Return the calibration in metres with its deviations, and the scatter of the depths."""
    array = result_of("wand", found)
    if options.wand is not None:
        return array, float("nan")
    scale, sigma, scatter_m = depth_scale(found.cameras, found.bodies.t, moments.depth_m[:, :, 0])
    array = moved_world(array, np.eye(3), np.zeros(3), scale)
    way = np.linalg.norm(array.cameras.centres, axis=1)
    return replace(array, centre_sigma_m=np.hypot(array.centre_sigma_m, sigma * way)), scatter_m


def held_out_errors(
    task: WandTask, found: Adjusted, moments: Moments, options: WandOptions
) -> tuple[float, np.ndarray]:
    """Return the error of held-out time ranges in pixels, and of the (3,) distances of the lights in metres."""
    out = held_out(moments.px.shape[1])
    if out.sum() < LEAST_TOGETHER or (~out).sum() < LEAST_TOGETHER:
        return float("nan"), np.full(3, np.nan)
    # The delay of a sensor is a single number, so it may come from the whole recording.
    refit = replace(task, cameras=found.cameras, delays=found.delays, find_delays=False)
    fitted, _ = adjusted(refit, moments.where(~out))
    kept = moments.where(out)
    at = triangulated(fitted.cameras, kept, found.delays)
    error = reprojection_px(fitted.cameras, kept, found.delays, at)
    px = float(np.sqrt(np.nanmean(error**2)))
    if options.wand is None:
        return px, np.full(3, np.nan)
    return px, np.sqrt(np.nanmean((distances(at) - options.wand.distances_m) ** 2, axis=0))


def findings_of(
    views: Sequence[WandView], array: CalibratedCameras, clocks: Clocks, options: WandOptions
) -> tuple[Diagnostic, ...]:
    """Return the warnings about a calibration."""
    found = [item for view in views for item in view.findings]
    for view in views:
        if view.crowded:
            cause = {"reason": "crowded", "lost": view.crowded, "of": len(view)}
            found.append(diagnostic("wand_rows_ignored", cameras=[view.name], **cause))
    first = array.cameras.names[0]
    for c, name in enumerate(array.cameras.names):
        if (error := array.camera_rmse_px[c]) > GOOD_PX:
            found.append(diagnostic("camera_off", reference="wand", unit="px", cameras=[name], size=error))
        if options.clocks is None and abs(ahead := clocks.offset_s[c]) > LATE_S:
            found.append(diagnostic("sensor_clock_differs", cameras=[name, first], size_ms=1e3 * ahead))
    return tuple(found)


def notes_of(
    moments: Moments, together: np.ndarray, names: tuple[str, ...], options: WandOptions
) -> tuple[Diagnostic, ...]:
    """Return the notes about a calibration."""
    i, j = np.unravel_index(np.argmin(together + 1e9 * np.eye(len(names))), together.shape)
    wand = "a marker and its depth"
    if options.wand is not None:
        wand = f"a wand of {options.wand.first_m:.3f} and {options.wand.second_m:.3f} m"
    figures = {"wand": wand, "moments": moments.px.shape[1], "together": together[i, j]}
    return (
        diagnostic("calibration_evidence", evidence="wand", cameras=[names[i], names[j]], **figures),
        diagnostic("world_origin", source="sensor", cameras=names[:1]),
    )


def wand_page(found: WandCalibration, ground: Ground | None = None) -> str:
    """Return the report as HTML, with up and floor of a Γ if there was one."""
    array, names = found.array, found.array.cameras.names
    head = [
        Tile("Held-out error", number(found.held_out_px, 2), "px", "of stretches of time that were not fitted"),
        Tile("Moments", str(found.moments), "", "that were solved"),
        Tile("Volume", number(found.coverage.volume_m3), "m³", "in which the wand was"),
    ]
    if np.isfinite(found.length_rmse_m).all():
        head.append(Tile("Wand's length", number(1e3 * found.length_rmse_m[2], 2), "mm", "RMS of the whole, held out"))
    if ground is not None:
        tilt = np.degrees(ground.tilt_sigma)
        head.append(Tile("Up", f"± {tilt:.2f}", "°", f"by the Γ in {ground.frames} clouds"))
    words = [*map(sentence, array.findings), *filter(None, [found.coverage.next_place()])]
    sensors = [(name, found.sensor_line(c)) for c, name in enumerate(names)]
    counts = found.together.astype(float)
    strength = counts / max(counts.max(), 1.0)
    together = heat_table(counts, names, names, strength=strength, unit="moments", digits=0)
    body = [
        tiles(head),
        section("What to look at", _paragraphs(words) or "<p>Nothing unusual was found.</p>"),
        section("Sensors", facts(sensors), "Places and deviations, about the whole array."),
        section("Clocks", facts((name, line) for name, line in zip(names, found.clocks.lines(), strict=True))),
        section("Seen together", together, "Moments at which two sensors saw the wand."),
        section("Where the wand was", "".join(_picture(found, c) for c in range(len(names))), _COVERED),
        section("How", _paragraphs([sentence(note) for note in array.notes])),
    ]
    return page_of("Calibration by wand", f"{len(names)} sensors, {text(', '.join(names))}", "".join(body))


_COVERED = f"Each sensor's picture in cells: dark with {LEAST_IN_CELL} sightings and more, light where none is."


def _paragraphs(words: Sequence[str]) -> str:
    return "".join(f"<p>{text(word)}</p>" for word in words)


def _picture(found: WandCalibration, c: int) -> str:
    width, height = found.coverage.size_px[c].tolist()
    grid = found.coverage.pictures[c]
    rows, columns = grid.shape
    w, h = width / columns, height / rows
    cells = "".join(
        f'<rect x="{w * x:.0f}" y="{h * y:.0f}" width="{w:.0f}" height="{h:.0f}" fill="#1f77b4" stroke="#888" '
        f'fill-opacity="{0.05 + 0.75 * min(grid[y, x] / LEAST_IN_CELL, 1.0):.2f}"/>'
        f'<text x="{w * (x + 0.5):.0f}" y="{h * (y + 0.6):.0f}" text-anchor="middle" font-size="{h / 4:.0f}">'
        f"{grid[y, x]}</text>"
        for y in range(rows)
        for x in range(columns)
    )
    name = escape(found.array.cameras.names[c])
    return (
        f'<svg viewBox="0 0 {width} {height}" width="{width // 2}" height="{height // 2}" role="img">'
        f"<title>{name}</title>{cells}</svg><p>{name}: {found.coverage.shares[c]:.0%}</p>"
    )
