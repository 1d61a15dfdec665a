"""A page about a calibration by wand: how good it is, who saw what together, where to wave next."""

from __future__ import annotations

from html import escape

import numpy as np

from solver_backend.exchange.diagnostics import sentence
from solver_backend.report.markup import Tile, facts, heat_table, number, section, text, tiles
from solver_backend.report.page import page_of
from solver_backend.sensors.wand.coverage import LEAST_IN_CELL
from solver_backend.sensors.wand.gamma import Ground
from solver_backend.sensors.wand.result import WandCalibration


def wand_page(found: WandCalibration, ground: Ground | None = None) -> str:
    """Return a whole page of HTML.

    Args:
        found: the calibration.
        ground: up and floor, where a Γ gave them.
    """
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
    words = [*map(sentence, array.findings), *([place] if (place := found.coverage.next_place()) else [])]
    body = [
        tiles(head),
        section(
            "What to look at", "".join(f"<p>{text(word)}</p>" for word in words) or "<p>Nothing unusual was found.</p>"
        ),
        section("Sensors", facts(_sensors(found)), "Places and deviations, about the whole array."),
        section("Clocks", facts((name, line) for name, line in zip(names, found.clocks.lines(), strict=True))),
        section("Seen together", _together(found), "Moments at which two sensors saw the wand."),
        section("Where the wand was", "".join(_picture(found, c) for c in range(len(names))), _COVERED),
        section("How", "".join(f"<p>{text(sentence(note))}</p>" for note in array.notes)),
    ]
    return page_of("Calibration by wand", f"{len(names)} sensors, {text(', '.join(names))}", "".join(body))


_COVERED = f"Each sensor's picture in cells: dark with {LEAST_IN_CELL} sightings and more, light where none is."


def _sensors(found: WandCalibration) -> list[tuple[str, str]]:
    array = found.array
    return [
        (
            name,
            f"{array.camera_rmse_px[c]:.2f} px, at ({', '.join(f'{v:.3f}' for v in array.cameras.centres[c])}) m "
            f"± {1e3 * array.centre_sigma_m[c]:.1f} mm, ± {np.degrees(array.turn_sigma[c]):.3f}°",
        )
        for c, name in enumerate(array.cameras.names)
    ]


def _together(found: WandCalibration) -> str:
    names, counts = found.array.cameras.names, found.together.astype(float)
    return heat_table(counts, names, names, strength=counts / max(counts.max(), 1.0), unit="moments", digits=0)


def _picture(found: WandCalibration, c: int) -> str:
    """Return one sensor's cells as a drawing."""
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
