"""Plots of the comparison as SVG files: knee flexion in a passage, and error against time."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from solver_backend.report.angles import knee_flexion_deg
from solver_backend.report.plots import WIDTH, PlotCurve, time_plot
from tests.benchmarks.comparison.judgement import Row
from tests.benchmarks.comparison.passage import Passage

_STYLE = """<style>
text{font:11px sans-serif;fill:#444}text.y{text-anchor:end}text.x{text-anchor:middle}.grid{stroke:#ddd}
.line{fill:none;stroke-width:1.6}.line.truth{stroke:#222;stroke-dasharray:5 3}.line.quiet{stroke:#aaa}
.line.b{stroke:#d9822b}.line.a{stroke:#1f77b4}circle{fill:#1f77b4}circle.ours{fill:#d62728}
</style>"""
STYLES = ("truth", "quiet", "b", "a")


def knee_flexion(path: Path, passage: Passage) -> None:
    """Write the knee flexion of the passage's motions (thesis figure 6.4), the left knee above the right."""
    for side in ("left", "right"):
        lines = [
            PlotCurve(knee_flexion_deg(motion.joints, side), label, style)
            for (label, motion), style in zip(passage.motions.items(), STYLES, strict=True)
        ]
        fps = next(iter(passage.motions.values())).fps
        drawing = re.search(r"<svg.*</svg>", time_plot(lines, fps, "°", size=(WIDTH, 260.0)), re.S)
        assert drawing is not None
        key = "".join(
            f'<path class="line {line.style}" d="M{60 + 220 * i} 16h24"/>'
            f'<text x="{90 + 220 * i}" y="20">{line.label}</text>'
            for i, line in enumerate(lines)
        )
        write_svg(path.with_name(f"{path.stem}_{side}.svg"), drawing[0].replace("</svg>", f"{key}</svg>"))


def error_against_time(path: Path, rows: dict[str, Row]) -> None:
    """Write MPJPE against processor seconds on a logarithmic axis (thesis figure 6.5)."""
    shown = {name: row for name, row in rows.items() if np.isfinite(row["mpjpe_mm"])}
    seconds = np.log10([row["cpu_s"] for row in shown.values()])
    error = np.array([row["mpjpe_mm"] for row in shown.values()])
    low, high = np.floor(seconds.min()), np.ceil(seconds.max() + 1e-9)
    x = 60 + 560 * (seconds - low) / max(high - low, 1.0)
    y = 300 - 270 * error / (1.1 * error.max())
    parts = [f'<text class="x" x="{60 + 560 * (d - low) / max(high - low, 1.0):.0f}" y="325">{10.0**d:g} s</text>'
             for d in np.arange(low, high + 1)]  # fmt: skip
    parts += [f'<text class="y" x="52" y="{300 - 270 * v / (1.1 * error.max()):.0f}">{v:.0f} mm</text>'
              for v in np.linspace(0, error.max(), 5)]  # fmt: skip
    for name, a, b in zip(shown, x, y, strict=True):
        ours = ' class="ours"' if name.startswith("ours") else ""
        parts.append(
            f'<circle{ours} cx="{a:.1f}" cy="{b:.1f}" r="5"/><text x="{a + 8:.1f}" y="{b + 4:.1f}">{name}</text>'
        )
    write_svg(path, f'<svg viewBox="0 0 760 335">{"".join(parts)}</svg>')


def write_svg(path: Path, drawing: str) -> None:
    """Write a drawing as a complete SVG file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    whole = drawing.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    path.write_text(re.sub(r"(<svg[^>]*>)", lambda m: m[1] + _STYLE, whole, count=1) + "\n", encoding="utf-8")
