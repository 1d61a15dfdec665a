"""Report a wand calibration: values, warnings, text lines and a page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras, moved_world
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.exchange.json_file import as_plain
from solver_backend.report.markup import Tile, facts, heat_table, number, section, text, tiles
from solver_backend.report.page import page_of
from solver_backend.sensors.wand.gamma import Ground
from solver_backend.sensors.wand.views import LEAST_IN_CELL, Coverage, Moments, Wand, WandView
from solver_backend.videos.sync.clocks import Clocks

GOOD_PX, LATE_S = 1.0, 0.001  # Largest error (pixels) and delay (seconds) without a warning. Chosen by hand.


@dataclass(frozen=True)
class WandOptions:
    """Options for a wand calibration."""

    wand: Wand | None = None  # The wand if it has three lights. None for a single marker with depth.
    clocks: Clocks | None = None  # Clocks given by a trigger. None estimates them from the wand's motion.
    every_sensor: bool = False  # Use only moments that all sensors saw, as published. Otherwise, two sensors suffice.


@dataclass(frozen=True)
class WandCalibration:
    """Result of a wand calibration, in the first sensor's axes or in the world of a Γ of markers on the floor."""

    array: CalibratedCameras
    clocks: Clocks
    together: np.ndarray  # (C, C) number of moments that each pair of sensors has in common.
    moments: int
    held_out_px: float  # RMS reprojection error in held-out time ranges.
    length_rmse_m: np.ndarray
    """(3,) RMS error of the distances between lights in those ranges. NaN for a single marker."""
    depth_rmse_m: float  # Standard deviation of measured depths from the marker's. NaN without depth.
    coverage: Coverage

    def sensor_line(self, c: int) -> str:
        """Describe a sensor's error, position and standard deviations in a line of text."""
        array = self.array
        x, y, z = np.round(array.cameras.centres[c], 3) + 0.0
        spread = f"± {1e3 * array.centre_sigma_m[c]:.1f} mm, ± {np.degrees(array.turn_sigma[c]):.3f}°"
        return f"{array.camera_rmse_px[c]:.2f} px, at ({x:.3f}, {y:.3f}, {z:.3f}) m {spread}"

    def lines(self) -> list[str]:
        """Describe the calibration in lines of text."""
        array, cameras = self.array, self.array.cameras
        held_out = f", {self.held_out_px:.2f} px held out" if np.isfinite(self.held_out_px) else ""
        how = f"by {array.method} at {self.moments} moments"
        lines = [f"{len(cameras)} sensors {how}, {array.rmse_px:.2f} px{held_out}"]
        if np.isfinite(self.length_rmse_m).all():
            first, second, whole = 1e3 * self.length_rmse_m
            lines.append(f"  lengths     {first:.2f}, {second:.2f} and {whole:.2f} mm RMS, held out")
        if np.isfinite(self.depth_rmse_m):
            lines.append(f"  depth       {1e3 * self.depth_rmse_m:.1f} mm of one measurement")
        lines += [f"  {name:<11} {self.sensor_line(c)}" for c, name in enumerate(cameras.names)]
        lines += [f"  clock       {sentence(note)}" for note in self.clocks.notes()]
        lines += [f"  seen        {line}" for line in self.coverage.lines()]
        if place := self.coverage.next_place():
            lines.append(f"  next        {place}")
        lines += [f"  note        {sentence(note)}" for note in array.notes]
        return lines + [f"  finding     {sentence(found)}" for found in array.findings]

    def as_dict(self) -> dict[str, object]:
        """Return the calibration as JSON values. Unknown numbers are None."""
        array = self.array
        of_cameras: dict[str, Iterable[object]] = {"name": array.cameras.names, "rmse_px": array.camera_rmse_px}
        of_cameras |= {"centre_sigma_mm": 1e3 * array.centre_sigma_m, "turn_sigma_deg": np.degrees(array.turn_sigma)}
        of_cameras |= {"centre_m": array.cameras.centres, "covered": self.coverage.shares}
        cameras = [dict(zip(of_cameras, row, strict=True)) for row in zip(*of_cameras.values(), strict=True)]
        data: dict[str, object] = {"rmse_px": array.rmse_px, "held_out_px": self.held_out_px}
        data["depth_rmse_mm"] = 1e3 * self.depth_rmse_m
        data |= {"method": array.method, "moments": self.moments, "cameras": cameras}
        data |= {"length_rmse_mm": 1e3 * self.length_rmse_m, "together": self.together, "clocks": self.clocks.as_dict()}
        data |= {"next": self.coverage.next_place(), "volume_m3": self.coverage.volume_m3}
        data |= {key: [sentence(item) for item in getattr(array, key)] for key in ("findings", "notes")}
        return as_plain(data | {"diagnostics": [item.as_dict() for item in (*array.findings, *array.notes)]})


def in_world(found: WandCalibration, ground: Ground) -> WandCalibration:
    """Transform a wand calibration to the world that a Γ of markers on the floor defines."""
    array = moved_world(found.array, ground.R, ground.t)
    note = diagnostic("world_origin", source="gamma", clouds=ground.frames, sigma_deg=np.degrees(ground.tilt_sigma))
    array = replace(array, notes=(found.array.notes[0], note), findings=(*array.findings, *ground.findings))
    return replace(found, array=array)


def findings_of(
    views: Sequence[WandView], array: CalibratedCameras, clocks: Clocks, options: WandOptions
) -> tuple[Diagnostic, ...]:
    """Return warnings about a wand calibration: frames with other lights, large errors and different clocks."""
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
    """Return notes about a wand calibration: how often the sensors saw the wand together, and the world's origin."""
    i, j = np.unravel_index(np.argmin(together + 1e9 * np.eye(len(names))), together.shape)
    wand = "marker"
    if options.wand is not None:
        wand = f"wand of {options.wand.first_m:.3f} and {options.wand.second_m:.3f} m"
    figures = {"wand": wand, "moments": moments.px.shape[1], "together": together[i, j]}
    return (
        diagnostic("calibration_evidence", evidence="wand", cameras=[names[i], names[j]], **figures),
        diagnostic("world_origin", source="sensor", cameras=names[:1]),
    )


def wand_page(found: WandCalibration, ground: Ground | None = None) -> str:
    """Return the report page of a wand calibration as HTML, with the floor if a Γ was recorded."""
    array, names = found.array, found.array.cameras.names
    head = [
        Tile("Held-out error", number(found.held_out_px, 2), "px", "in time ranges that were not fitted"),
        Tile("Moments", str(found.moments), "", "that were solved"),
        Tile("Volume", number(found.coverage.volume_m3), "m³", "with the wand"),
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
        section("Warnings", _paragraphs(words) or "<p>Nothing unusual was found.</p>"),
        section("Sensors", facts(sensors), "The table shows the position and the standard deviation of each sensor."),
        section("Clocks", _paragraphs([sentence(note) for note in found.clocks.notes()])),
        section("Seen together", together, "The table shows how often two sensors saw the wand together."),
        section("Coverage of the wand", "".join(_picture(found, c) for c in range(len(names))), _COVERED),
        section("How", _paragraphs([sentence(note) for note in array.notes])),
    ]
    return page_of("Wand calibration", f"{len(names)} sensors, {text(', '.join(names))}", "".join(body))


_COVERED = (
    f"The image of each sensor is divided into cells. Dark cells have {LEAST_IN_CELL} or more sightings, "
    "and light cells have none."
)


def _paragraphs(words: Sequence[str]) -> str:
    return "".join(f"<p>{text(word)}</p>" for word in words)


def _picture(found: WandCalibration, c: int) -> str:
    grid = found.coverage.pictures[c].astype(float)
    rows, columns = ([str(n + 1) for n in range(count)] for count in grid.shape)
    strength = np.minimum(grid / LEAST_IN_CELL, 1.0)
    table = heat_table(grid, rows, columns, strength=strength, unit="sightings", digits=0)
    return f"<p>{text(found.array.cameras.names[c])}: {found.coverage.shares[c]:.0%}</p>{table}"
