"""The section on how the cameras fit what they saw, from figures that were measured where calibrations are made."""

from __future__ import annotations

import numpy as np

from solver_backend.report.markup import facts, heat_table, number, section, text
from solver_backend.report.plots import PlotCurve, time_plot
from solver_backend.types import Capture
from solver_backend.types.cameras import COLUMNS, ROWS, CameraFits


def calibration_section(capture: Capture, fit: CameraFits | None) -> str:
    """Return the section; nothing where it was not checked."""
    if fit is None or capture.cameras is None:
        return ""
    names = capture.cameras.names
    items = "".join(f'<li class="look">{text(word)}</li>' for word in fit.findings)
    items = items or '<li class="good">Nothing contradicts the calibration.</li>'
    grid = np.concatenate([fit.camera_px[:, None], fit.best_px[:, None], fit.region_px.reshape(len(names), 9)], axis=1)
    columns = ["all", "at best", *(f"{row} {column}" for row in ROWS for column in COLUMNS)]
    usual = max(float(np.nanmedian(fit.camera_px)), 1e-9)
    table = heat_table(grid, names, columns, strength=grid / (3.0 * usual), unit="px")
    windows = fit.epipolar_px.shape[1]
    frames = capture.num_frames
    where = np.minimum(np.arange(frames) * windows // max(frames, 1), windows - 1)
    lines = [PlotCurve(fit.epipolar_px[c, where], name, "ab"[c] if c < 2 else "quiet") for c, name in enumerate(names)]
    plot = time_plot(lines, capture.fps, "px", from_zero=True)
    world = facts([
        ("stature by the calibration's scale", f"{number(fit.stature_m, 2)} m"),
        ("the person's up against the world's", f"{number(fit.tilt_deg)}° ± {number(fit.tilt_sigma_deg)}°"),
    ])  # fmt: skip
    lead = (
        f"How well the cameras fit this take: {text(fit.verdict)}. <i>At best</i> is after the poses "
        "were adjusted to the take: a camera far above it was moved. A rim far above the middle points at a lens of "
        "another zoom. An epipolar distance that grows points at a camera that was touched, or a clock of another rate."
    )
    body = (
        f'<ul class="findings">{items}</ul><h3>Reprojection error by part of the picture, px</h3>{table}'
        f"<h3>Distance to epipolar lines over the take, px</h3>{plot}<h3>The world</h3>{world}"
    )
    return section("Calibration", body, lead, "calibration")
