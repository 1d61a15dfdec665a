"""Show the results of a data set's benchmark as a text table and as a page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from colorsys import hls_to_rgb
from hashlib import sha256
from itertools import cycle, product
from pathlib import Path

import numpy as np

from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.png import png_bytes, read_png
from solver_backend.report import page as report_page
from solver_backend.report.markup import heat_table, section, text
from solver_backend.report.plots import PlotCurve, time_plot
from solver_backend.synthesis.studio.benchmark.place_errors import PlaceErrors
from solver_backend.synthesis.studio.benchmark.solve_and_compare import Verdict
from solver_backend.synthesis.studio.contact_sheet import shown
from solver_backend.synthesis.studio.data_set import SHOTS
from solver_backend.synthesis.studio.z_buffer import in_camera
from solver_backend.types import SMPL_PARENTS

_WORST = 4  # Number of frames with the largest errors that the page shows. Chosen by hand.
_KINDS = ("rgb", "infrared", "masks")
_TRUE, _FOUND = (60, 220, 110), (255, 80, 60)


def table(verdicts: Sequence[Verdict]) -> str:
    """Return the mean results over all shots as a text table."""
    wide = max((len(v.array) for v in verdicts), default=0) + 2
    head = f"{'array':<{wide}}{'input':<9}{'method':<15}{'faults':<11}{'shots':>6}"
    lines = [f"{head}{'MPJPE':>9}{'PA':>11}{'accel':>8}{'time':>8}  failed"]
    for group in dict.fromkeys((v.array, v.source, v.method, v.faults) for v in verdicts):
        array, source, method, kind = group
        found = [v for v in verdicts if (v.array, v.source, v.method, v.faults) == group]
        good = [v for v in found if not v.error]
        figures = zip(*((v.mpjpe_mm, v.pa_mpjpe_mm, v.accel_m_s2, v.seconds) for v in good), strict=True)
        means = [float(np.mean(values)) for values in figures] or [np.nan] * 4
        lines.append(
            f"{array:<{wide}}{source:<9}{method:<15}{kind:<11}{len(found):>6}{means[0]:>6.1f} mm"
            f"{means[1]:>8.1f} mm{means[2]:>8.2f}{means[3]:>6.1f} s  {len(found) - len(good) or '-'}"
        )
    return "\n".join(lines)


def page_html(out: Path, name: str, verdicts: Sequence[Verdict], places: Sequence[PlaceErrors] = ()) -> str:
    """Return the benchmark page of the data set in ``out`` as HTML."""
    parts = []
    if verdicts:
        means = section("All shots", f"<pre>{text(table(verdicts))}</pre>", "Means over the solved shots.", "means")
        parts += [means, _shots_section(verdicts), _time_section(out, verdicts), _worst(out, verdicts)]
    if places:
        located = [p for p in places if p.median_mm is not None]
        low = min((float(np.nanmin(p.error_mm)) for p in located), default=0.0)
        high = max((float(np.nanpercentile(p.error_mm, 95)) for p in located), default=1.0)
        drawn = "".join(place_map(p, low, high) for p in places)
        lead = (
            "The maps show the error of triangulated keypoints at each position on the floor, seen from above. "
            "Triangles are cameras."
        )
        parts.append(section("By place", drawn, lead, "places"))
    style = Path(report_page.__file__).with_name("page.css").read_text(encoding="utf-8")
    allowed = base64.b64encode(sha256(style.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; img-src data:; style-src-elem 'sha256-{allowed}'; style-src-attr 'unsafe-inline'; "
        "base-uri 'none'; form-action 'none'"
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta http-equiv="Content-Security-Policy" '
        f'content="{policy}"><meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>Benchmark of {text(name)}</title><style>{style}</style></head><body><main>"
        f"<h1>Benchmark of {text(name)}</h1>{''.join(parts)}</main></body></html>\n"
    )


def place_map(places: PlaceErrors, low_mm: float, high_mm: float) -> str:
    """Draw the error at each floor position as SVG, from light (``low_mm``) to dark (``high_mm``)."""
    xs, ys = places.x_m, places.y_m
    cell = 34.0
    width, height = cell * len(xs), cell * len(ys)
    step_x, step_y = xs[1] - xs[0], ys[1] - ys[0]
    drawn = []
    for (row, column), value in np.ndenumerate(places.error_mm):
        x, y = cell * column, height - cell * (row + 1)
        square = f'<rect x="{x:.0f}" y="{y:.0f}" width="{cell}" height="{cell}"'
        if not np.isfinite(value):
            drawn.append(f'{square} fill="#8886"/>')
            continue
        share = float(np.clip((value - low_mm) / max(high_mm - low_mm, 1e-9), 0, 1))
        colour = hls_to_rgb((210 - 200 * share) / 360, 0.72 - 0.22 * share, 0.7)
        fill = "#" + "".join(f"{round(255 * part):02x}" for part in colour)
        where = f"({xs[column]:.1f}, {ys[row]:.1f}) m, seen by {places.views[row, column]:.1f} cameras"
        drawn.append(
            f'{square} fill="{fill}"><title>{value:.1f} mm at {where}</title></rect>'
            f'<text x="{x + cell / 2:.0f}" y="{y + cell / 2 + 4:.0f}" font-size="11" text-anchor="middle">'
            f"{value:.0f}</text>"
        )
    corners = [(-cell, -cell), (width + cell, height + cell)]
    for centre in places.cameras:
        x = cell * ((centre[0] - xs[0]) / step_x + 0.5)
        y = height - cell * ((centre[1] - ys[0]) / step_y + 0.5)
        corners += [(x - 12, y - 12), (x + 12, y + 12)]
        drawn.append(f'<path d="M{x - 6:.0f} {y + 5:.0f}h12l-6 -11z" fill="currentColor"/>')
    median = places.median_mm
    message = "no keypoint can be triangulated" if median is None else f"median {median:.1f} mm over the floor"
    low, size = np.min(corners, axis=0), np.ptp(corners, axis=0)
    return (
        f"<figure><svg viewBox='{low[0]:.0f} {low[1]:.0f} {size[0]:.0f} {size[1]:.0f}' "
        f"width='{size[0]:.0f}' height='{size[1]:.0f}' role='img' aria-label='error by place'>{''.join(drawn)}</svg>"
        f"<figcaption>{text(places.array)}: {message}</figcaption></figure>"
    )


def _shots_section(verdicts: Sequence[Verdict]) -> str:
    shots = list(dict.fromkeys(v.shot for v in verdicts))
    groups = list(dict.fromkeys((v.source, v.method, v.faults) for v in verdicts))
    values = np.full((len(shots), len(groups)), np.nan)
    for v in verdicts:
        values[shots.index(v.shot), groups.index((v.source, v.method, v.faults))] = v.mpjpe_mm
    strength = np.nan_to_num(values / max(float(np.nanmax(values)) if np.isfinite(values).any() else 1.0, 1e-9))
    body = heat_table(values, shots, [" ".join(group) for group in groups], strength=strength, unit="mm")
    failed = "".join(f"<p>{text(v.shot)}, {text(v.method)}: {text(v.error)}</p>" for v in verdicts if v.error)
    return section("By shot", body + failed, "Mean joint error in millimetres.", "shots")


def _time_section(out: Path, verdicts: Sequence[Verdict]) -> str:
    """Plot the errors of all methods over the frames of the worst shot."""
    solved = [v for v in verdicts if v.by_frame_mm is not None]
    if not solved:
        return ""
    worst = max(solved, key=lambda v: v.mpjpe_mm).shot
    styles = cycle(("a", "b", "quiet", "truth"))
    lines = [
        PlotCurve(v.by_frame_mm, f"{v.source} {v.method} {v.faults}", next(styles))
        for v in solved
        if v.shot == worst and v.by_frame_mm is not None
    ]
    fps = read_capture(out / SHOTS / worst / "clean.npz").fps
    return section(f"Over time: {worst}", time_plot(lines, fps, "mm", from_zero=True), "Mean joint error.", "time")


def _worst(out: Path, verdicts: Sequence[Verdict]) -> str:
    """Show the worst frames, with the true skeleton in green and the solved one in red."""
    frames = [
        (float(np.nanmax(v.by_frame_mm)), v, int(np.nanargmax(v.by_frame_mm)))
        for v in verdicts
        if v.by_frame_mm is not None and v.joints is not None and np.isfinite(v.by_frame_mm).any()
    ]
    figures = []
    for error, v, frame in sorted(frames, key=lambda item: -item[0])[:_WORST]:
        data = base64.b64encode(png_bytes(_worst_picture(out, v, frame))).decode()
        words = text(f"{v.shot}, frame {frame}, {v.method} of {v.faults} {v.source}: {error:.0f} mm")
        picture = f'<img alt="{words}" width="480" src="data:image/png;base64,{data}">'
        figures.append(f"<figure>{picture}<figcaption>{words}</figcaption></figure>")
    return section("Worst frames", "".join(figures), "Truth in green, the solve in red.", "worst") if figures else ""


def _worst_picture(out: Path, verdict: Verdict, frame: int) -> np.ndarray:
    """Return the (h, w, 3) uint8 image of the camera that shows the error best, with true and solved skeleton."""
    capture = read_capture(out / SHOTS / verdict.shot / "clean.npz")
    assert capture.cameras is not None and verdict.joints is not None
    truth, cameras = np.asarray(capture.truth["joints"])[frame], capture.cameras
    both = truth, verdict.joints[frame]
    drawn = [[in_camera(cameras, c, joints)[1] for joints in both] for c in range(len(cameras))]
    sizes = [float(np.nanmean(np.linalg.norm(a - b, axis=1))) if np.isfinite(a).any() else -1.0 for a, b in drawn]
    view = int(np.nanargmax(sizes))
    width, height = cameras.image_size[view].tolist()
    folder, name = out / SHOTS / verdict.shot, cameras.names[view]
    path = next((p for k in _KINDS if (p := folder / k / name / f"{frame:06d}.png").is_file()), None)
    picture = np.full((height, width, 3), 40, np.uint8)
    if path is not None:
        picture = shown(path.parent.parent.name, read_png(path)).copy()
    for points, colour in zip(drawn[view], (_TRUE, _FOUND), strict=True):
        _draw_skeleton(picture, points, colour)
    return picture


def _draw_skeleton(picture: np.ndarray, px: np.ndarray, colour: tuple[int, int, int]) -> None:
    height, width = picture.shape[:2]
    for joint, parent in enumerate(SMPL_PARENTS):
        ends = px[[joint, max(parent, 0)]]
        if not np.isfinite(ends).all():
            continue
        count = int(np.clip(2 * np.abs(ends[1] - ends[0]).max(), 2, 4000))
        along = np.round(ends[0] + np.linspace(0, 1, count)[:, None] * (ends[1] - ends[0])).astype(int)
        for dy, dx in product((0, 1), (0, 1)):
            x, y = along[:, 0] + dx, along[:, 1] + dy
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            picture[y[inside], x[inside]] = colour
