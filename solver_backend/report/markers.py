"""The page's sections about optical markers: residuals by marker and over time, and where markers are missing."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.quantiles import quantile
from solver_backend.report.markup import heat_table, section
from solver_backend.report.plots import WIDTH, PlotCurve, Shade, strip_plot, time_plot
from solver_backend.types import MARKER_FILLED, MARKER_GHOST, MARKER_SWAPPED, Motion


def residual_over_time(motion: Motion, shades: list[Shade], key: str) -> str:
    """The markers' residual over time, with flagged frames shaded and keyframes ticked."""
    error = motion.marker_residual_mm
    if error is None:
        return ""
    lines = [
        PlotCurve(quantile(error, 0.9, axis=1), "90 % below", "quiet"),
        PlotCurve(quantile(error, 0.5, axis=1), "median", "a"),
    ]
    marks = None if motion.keyframes is None else np.flatnonzero(motion.keyframes)
    plot = time_plot(lines, motion.fps, "mm", shades=shades, marks=marks, from_zero=True, size=(WIDTH, 190))
    lead = "Distance between the solved body's markers and the recorded ones. Look at the peaks first."
    legend = '<p class="key"><b class="a">— median</b> &nbsp; — 90 % of the markers are below</p>'
    return section("Residual over time", plot + legend + key, lead, "residual")


def marker_section(motion: Motion) -> str:
    """Each marker's residual, and in how many frames it is seen."""
    error = motion.marker_residual_mm
    if error is None or motion.marker_labels is None:
        return ""
    shares = [quantile(error, q, axis=0) for q in (0.5, 0.95)]
    mean = np.nansum(error, axis=0) / np.maximum(np.isfinite(error).sum(axis=0), 1)
    seen = 100 * np.isfinite(error).mean(axis=0)
    mean = np.where(seen > 0, mean, np.nan)
    usual = max(2.5 * float(np.nan_to_num(quantile(error.ravel(), 0.5, axis=0))), 1e-9)
    values = np.stack([mean, *shares], axis=1)
    names = [label.rpartition(":")[2] for label in motion.marker_labels]
    left = heat_table(values, names, ["mean", "median", "95 % below"], strength=values / usual, unit="mm")
    shares, heads = _shares(motion, seen)
    faint = np.concatenate([(100 - shares[:, :1]) / 40, shares[:, 1:] / 10], axis=1)
    right = heat_table(shares, names, heads, strength=faint, unit="%", digits=0)
    lead = (
        "How far the solved body's markers are from the recorded ones; each marker's place on the body was learned. "
        "A marker that stands out may be named wrongly, lie elsewhere than its name states, or be loose."
    )
    body = (
        f'<div class="pair"><div><h3>Residual in millimetres</h3>{left}</div>'
        f"<div><h3>Frames, in percent</h3>{right}</div></div>"
    )
    return section("Markers", body, lead, "markers")


def _shares(motion: Motion, seen: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return (M, n) percentages of the frames in which each marker is seen, filled, exchanged and rejected."""
    if motion.marker_flags is None:
        return seen[:, None], ["seen"]
    bits = {"filled": MARKER_FILLED, "exchanged": MARKER_SWAPPED, "rejected": MARKER_GHOST}
    parts = [100 * ((motion.marker_flags & bit) > 0).mean(axis=0) for bit in bits.values()]
    return np.stack([seen, *parts], axis=1), ["seen", *bits]


def gaps_section(motion: Motion, shades: list[Shade]) -> str:
    """Which markers are missing, frame by frame."""
    if motion.marker_residual_mm is None or motion.marker_labels is None:
        return ""
    seen = np.isfinite(motion.marker_residual_mm)
    incomplete = np.flatnonzero(~seen.all(axis=0))
    rows = [(motion.marker_labels[i].rpartition(":")[2], seen[:, i].astype(float)) for i in incomplete]
    rows.append(("all markers", seen.mean(axis=1)))
    lead = "Where markers are seen; only those with gaps are named. The last row is the share of all markers."
    return section("Missing data", strip_plot(rows, motion.fps, shades=shades), lead, "missing")
