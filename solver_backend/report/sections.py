"""Write the sections of a solve's report. Functions return an empty string if there is no data."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, notes_in, warnings_in, word
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.geometry.arrays import quantile, true_runs
from solver_backend.metrics import distances_m
from solver_backend.report import angles
from solver_backend.report.markup import facts, heat_table, number, section, text, tints
from solver_backend.report.plots import WIDTH, PlotCurve, Shade, plan, strip_plot, time_plot
from solver_backend.report.statistics import KeypointResiduals, detected_share, located_share
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, MARKER_FILLED, MARKER_GHOST, MARKER_SWAPPED, Capture, Motion
from solver_backend.types.cameras import COLUMNS, ROWS, CameraFits

SIDES_KEY = '<p class="key"><b class="a">— left</b> &nbsp; <b class="b">— right</b>{truth}</p>'
SHADES_KEY = (
    '<p class="key"><b class="unsure">■</b> {far} or very uncertain &nbsp; <b class="unseen">■</b> interpolated: '
    "{interpolated} &nbsp; │ ticks below: keyframes of the solver</p>"
)


def far_from(motion: Motion) -> str:
    """Return the words with which a legend explains uncertain frames."""
    return "far from the detections" if motion.markers is None else "far from the markers"


def why_interpolated(motion: Motion) -> str:
    """Return the reason why frames were interpolated, as words in a legend."""
    if motion.markers is not None:
        return "too few visible markers"
    is_one = motion.reprojection_px is not None and len(motion.reprojection_px) == 1
    return f"not seen by {'the camera' if is_one else 'two cameras'}"


def shades_key(motion: Motion) -> str:
    """Return the legend of plots with shaded frame ranges as HTML."""
    return SHADES_KEY.format(far=far_from(motion), interpolated=why_interpolated(motion))


def shades_of(motion: Motion) -> list[Shade]:
    """Return the flagged frame ranges of a motion for shading in plots."""
    if motion.flags is None:
        return []
    kinds = ((FLAG_UNSURE, "unsure", f"{far_from(motion)} or very uncertain"), (FLAG_UNSEEN, "unseen", "interpolated"))
    return [
        Shade(first, last, kind, f"frames {first}-{last}: {label}")
        for bit, kind, label in kinds
        for first, last in true_runs((motion.flags & bit) > 0)
    ]


def diagnostics_section(found: Sequence[Diagnostic], fps: float) -> str:
    """List the warnings and notes of a capture or solve."""
    good = '<li class="good">OK: there are no warnings.</li>'
    warnings = "".join(_item(item, "bad", fps) for item in warnings_in(found))
    notes = "".join(_item(item, "note", fps) for item in notes_in(found))
    body = f'<ul class="findings">{warnings or good}</ul>'
    body += f'<h3>Notes</h3><ul class="findings">{notes}</ul>' if notes else ""
    return section("Warnings and notes", body, identifier="look")


def _item(found: Diagnostic, level: str, fps: float) -> str:
    what, advice = word(found, fps)
    return f'<li class="{level}">{text(what)}<span class="advice">{text(advice)}</span></li>'


def reprojection_section(capture: Capture, residuals: KeypointResiduals | None) -> str:
    """Show each camera's and keypoint's reprojection error, and the percentage of inliers."""
    if residuals is None or capture.cameras is None or capture.keypoints is None:
        return ""
    cameras = [*capture.cameras.names, "all"]
    rows = [*capture.keypoints.joint_set.keypoints, "all keypoints"]
    error = _with_margins(
        residuals.by_camera_and_keypoint, residuals.by_keypoint, residuals.by_camera, residuals.median_px
    )
    shares = [residuals.agreement_percent(axis) for axis in (1, (0, 1), (1, 2), (0, 1, 2))]
    agreement = _with_margins(shares[0].T, shares[1], shares[2], float(shares[3]))
    tint = tints(error, residuals.median_px)
    left = heat_table(error, rows, cameras, strength=tint, unit="px", total=True)
    right = heat_table(agreement, rows, cameras, strength=(100 - agreement) / 40, unit="%", digits=0, total=True)
    low, high = (number(float(limit), 0) for limit in (residuals.limit_px.min(), residuals.limit_px.max()))
    limits = f"{low} px" if low == high else f"{low} to {high} px, by keypoint"
    lead = (
        "The tables show the distance between the solved body and each camera's detections, and the share of "
        f"detections within the outlier limit ({limits}). A conspicuous column suggests a problem with a camera, a "
        "conspicuous row a problem with a keypoint, and a single cell an occlusion."
    )
    body = (
        f'<div class="pair"><div><h3>Median reprojection error in pixels</h3>{left}</div>'
        f"<div><h3>Detections that agree with the solve, in percent</h3>{right}</div></div>"
    )
    return section("Cameras and keypoints", body, lead, "cameras")


def _with_margins(inner: np.ndarray, rows: np.ndarray, columns: np.ndarray, total: float) -> np.ndarray:
    return np.block([[inner, rows[:, None]], [columns[None], np.array([[total]])]])


def missing_section(capture: Capture, motion: Motion) -> str:
    """Show the share of keypoints that each camera detects over time."""
    seen, located = detected_share(capture), located_share(capture)
    if seen is None or located is None:
        return ""
    names = capture.cameras.names if capture.cameras is not None else [f"view {c}" for c in range(len(seen))]
    rows = [(str(name), seen[c]) for c, name in enumerate(names)]
    lead = "The strips show the share of keypoints that each camera detected. Full colour means all, and empty none."
    if capture.least_views > 1:
        rows.append(("two or more", located))
        lead += " Keypoints detected by two or more cameras can be triangulated."
    return section("Missing data", strip_plot(rows, motion.fps, shades=shades_of(motion)), lead, "missing")


def residual_sections(motion: Motion, residuals: KeypointResiduals | None) -> str:
    """Plot the residuals of detections and markers over time, with flagged frames and keyframes."""
    shown = ""
    if residuals is not None:
        curves = residuals.by_frame(0.5), residuals.by_frame(0.9)
        ends = "the solved body and the detections of all cameras"
        shown = _residual_section(motion, curves, "px", "detections", ends)
    error = motion.marker_residual_mm
    if error is not None:
        curves = quantile(error, 0.5, axis=1), quantile(error, 0.9, axis=1)
        shown += _residual_section(motion, curves, "mm", "markers", "the solved body's markers and the recorded ones")
    return shown


def _residual_section(motion: Motion, curves: tuple[np.ndarray, np.ndarray], unit: str, points: str, ends: str) -> str:
    lines = [PlotCurve(curves[1], "90 % below", "quiet"), PlotCurve(curves[0], "median", "a")]
    marks = None if motion.keyframes is None else np.flatnonzero(motion.keyframes)
    plot = time_plot(lines, motion.fps, unit, shades=shades_of(motion), marks=marks, from_zero=True, size=(WIDTH, 190))
    key = f'<p class="key"><b class="a">— median</b> &nbsp; — 90 % of the {points} are below this line</p>'
    lead = f"The plot shows the distance between {ends}. Check the peaks first."
    return section("Residual over time", plot + key + shades_key(motion), lead, "residual")


def angles_section(capture: Capture, motion: Motion) -> str:
    """Plot the joint angles of both sides, and the ground truth if it is known."""
    truth = _truth_joints(capture, motion)
    both = [
        ("Knee flexion", "°", angles.knee_flexion_deg),
        ("Hip flexion", "°", angles.hip_flexion_deg),
        ("Elbow flexion", "°", angles.elbow_flexion_deg),
        ("Shoulder elevation", "°", angles.shoulder_elevation_deg),
        ("Height of the foot joint", "cm", angles.foot_height_cm),
    ]
    plots = []
    for title, unit, measure in both:
        lines = [] if truth is None else [PlotCurve(measure(truth, s), f"true {s}", "truth") for s in SIDES]
        lines += [PlotCurve(measure(motion.joints, s), s, style) for s, style in zip(SIDES, "ab", strict=True)]
        plots.append(_small_plot(title, unit, lines, motion))
    lean = [PlotCurve(angles.trunk_lean_deg(truth), "true", "truth")] if truth is not None else []
    lean.append(PlotCurve(angles.trunk_lean_deg(motion.joints), "trunk"))
    plots.append(_small_plot("Trunk lean from the vertical", "°", lean, motion))
    key = SIDES_KEY.format(truth=' &nbsp; <b class="truth">┄ truth</b>' if truth is not None else "")
    lead = (
        "Curves should be smooth. Spikes indicate jitter, and steps indicate swapped limbs. At 0°, a joint is "
        "straight or an arm hangs down."
    )
    return section("Joint angles", f'<div class="pair">{"".join(plots)}</div>{key}', lead, "angles")


def _small_plot(title: str, unit: str, lines: list[PlotCurve], motion: Motion) -> str:
    plot = time_plot(lines, motion.fps, unit, shades=shades_of(motion), size=(500.0, 140.0))
    return f"<div><h3>{text(title)}, {text(unit)}</h3>{plot}</div>"


def truth_section(capture: Capture, motion: Motion, figures: list[str]) -> str:
    """Show the errors relative to the ground truth of a synthetic capture."""
    solved, truth, names = motion.beside_truth(capture.truth.get("joints", np.zeros(0)))
    if not names:
        return ""
    error = 1000.0 * distances_m(solved, truth)
    key = '<p class="key"><b class="a">— mean</b> &nbsp; — worst joint</p>'
    lines = [PlotCurve(error.max(axis=1), "worst joint", "quiet"), PlotCurve(error.mean(axis=1), "mean")]
    plot = time_plot(lines, motion.fps, "mm", shades=shades_of(motion), from_zero=True) + key
    per_joint = error.mean(axis=0)
    tint = per_joint[:, None] / max(2.5 * per_joint.mean(), 1e-9)
    table = heat_table(per_joint[:, None], names, ["mm"], strength=tint, unit="mm")
    summary = f"<pre>{text(chr(10).join(figures))}</pre>" if figures else ""
    joints = f"<details><summary>Each joint</summary>{table}</details>"
    body = f"{summary}<h3>Error of the {len(names)} joints over time, mm</h3>{plot}{joints}"
    lead = "The capture is synthetic, so its true motion is known."
    if capture.keypoints is not None:
        lead += " The baseline is triangulation followed by a 6 Hz Butterworth filter."
    return section("Against the truth", body, lead, "truth")


def _truth_joints(capture: Capture, motion: Motion) -> np.ndarray | None:
    truth = capture.truth.get("joints")
    known = truth is not None and motion.beside_truth(truth)[2]
    return np.asarray(truth, dtype=np.float64) if known else None


def uncertainty_section(motion: Motion) -> str:
    """Plot the joints' standard deviations over time."""
    if motion.joint_sigma is None:
        return ""
    sigma = 1000.0 * np.asarray(motion.joint_sigma, dtype=np.float64)
    lead, marks = "The plot shows the standard deviations of the joints as estimated by the solver.", None
    if motion.keyframes is not None:
        marks = np.flatnonzero(motion.keyframes)
        lead += " The regular ripple is not motion. Frames between keyframes (ticks) average their neighbours' errors."
    if motion.resting is not None:
        always = motion.resting.all(axis=0)
        names = ", ".join(np.array(motion.body_layout.joints)[always]).replace("_", " ")
        lead += f" Joints in the rest pose have no data and are omitted{f': {names}' if names else ''}."
        sigma = np.where(motion.resting, np.nan, sigma)[:, ~always]
    lines = [
        PlotCurve(np.nanmax(sigma, axis=1), "least certain joint", "quiet"),
        PlotCurve(np.nanmedian(sigma, axis=1), "median"),
    ]
    plot = time_plot(lines, motion.fps, "mm", shades=shades_of(motion), marks=marks, from_zero=True)
    return section("Uncertainty", plot, lead, "sigma")


def scene_section(capture: Capture, motion: Motion) -> str:
    """Draw the scene from above, and show the body shape."""
    way = np.linalg.norm(np.diff(motion.joints[:, 0, :2], axis=0), axis=-1).sum()
    rows: list[tuple[str, object]] = [
        ("body", motion.body),
        ("shape (betas)", ", ".join(f"{b:+.2f}" for b in motion.betas)),
        ("height of the highest joint", f"{motion.joints[..., 2].max():.2f} m"),
        ("height of the lowest joint", f"{100 * motion.joints[..., 2].min():.1f} cm"),
        ("path of the pelvis", f"{way:.2f} m over the floor"),
    ]
    if capture.cameras is not None:
        named = zip(capture.cameras.names, capture.cameras.centres[:, 2], strict=True)
        rows.append(("height of the cameras", ", ".join(f"{name} {z:.2f} m" for name, z in named)))
    wedges = "" if capture.cameras is None else ". Wedges show the camera views"
    lead = (
        "The plan shows the scene from above, with the world's Y axis up. The path of the pelvis starts at the "
        f"green point and ends at the red point{wedges}."
    )
    drawing = plan(capture.cameras, motion.joints[:, 0, :2])
    return section("Scene", f'<div class="pair">{drawing}{facts(rows)}</div>', lead, "scene")


def provenance_section(capture: Capture, motion: Motion) -> str:
    """Show the settings, sources and versions used for the solve."""
    provenance = motion.provenance
    settings = provenance.get("settings")
    rows: list[tuple[str, object]] = [("capture", capture.name)]
    rows += [(f"setting {key}", value) for key, value in settings.items()] if isinstance(settings, dict) else []
    rows += [("source", source) for source in capture.sources]
    plain = json.dumps(provenance, indent=1, sort_keys=True, default=str, ensure_ascii=False)
    raw = f"<details><summary>Everything the motion file records</summary><pre>{text(plain)}</pre></details>"
    return section("Settings and provenance", facts(rows) + raw, "", "provenance")


def marker_section(motion: Motion) -> str:
    """Show each marker's residual, and the percentage of frames in which it is visible."""
    error = motion.marker_residual_mm
    if error is None or motion.marker_labels is None:
        return ""
    shares = [quantile(error, q, axis=0) for q in (0.5, 0.95)]
    mean = np.nansum(error, axis=0) / np.maximum(np.isfinite(error).sum(axis=0), 1)
    seen = 100 * np.isfinite(error).mean(axis=0)
    mean = np.where(seen > 0, mean, np.nan)
    usual = float(quantile(error.ravel(), 0.5, axis=0))
    values = np.stack([mean, *shares], axis=1)
    names = [label.rpartition(":")[2] for label in motion.marker_labels]
    left = heat_table(values, names, ["mean", "median", "95 % below"], strength=tints(values, usual), unit="mm")
    shares, heads = _shares(motion, seen)
    faint = np.concatenate([(100 - shares[:, :1]) / 40, shares[:, 1:] / 10], axis=1)
    right = heat_table(shares, names, heads, strength=faint, unit="%", digits=0)
    lead = (
        "The table shows the distance between the recorded markers and the markers on the solved body. Each "
        "marker's position on the body was estimated. A conspicuous marker may be loose, have a wrong name, or be "
        "far from its position in the layout."
    )
    body = (
        f'<div class="pair"><div><h3>Residual in millimetres</h3>{left}</div>'
        f"<div><h3>Frames, in percent</h3>{right}</div></div>"
    )
    return section("Markers", body, lead, "markers")


def _shares(motion: Motion, seen: np.ndarray) -> tuple[np.ndarray, list[str]]:
    if motion.marker_flags is None:
        return seen[:, None], ["seen"]
    bits = {"filled": MARKER_FILLED, "exchanged": MARKER_SWAPPED, "rejected": MARKER_GHOST}
    parts = [100 * ((motion.marker_flags & bit) > 0).mean(axis=0) for bit in bits.values()]
    return np.stack([seen, *parts], axis=1), ["seen", *bits]


def gaps_section(motion: Motion) -> str:
    """Show when each marker is missing."""
    if motion.marker_residual_mm is None or motion.marker_labels is None:
        return ""
    seen = np.isfinite(motion.marker_residual_mm)
    incomplete = np.flatnonzero(~seen.all(axis=0))
    rows = [(motion.marker_labels[i].rpartition(":")[2], seen[:, i].astype(float)) for i in incomplete]
    rows.append(("all markers", seen.mean(axis=1)))
    lead = "The rows show when markers are visible. Markers without gaps have no row. The last row is for all markers."
    return section("Missing data", strip_plot(rows, motion.fps, shades=shades_of(motion)), lead, "missing")


def props_section(motion: Motion) -> str:
    """Plot each prop's standard deviations over time, and show how often its markers are visible."""
    lead = (
        "Props are objects with markers that are not on the person. They are solved as rigid bodies. The curves "
        "are the standard deviations of the origin and of the rotation about the least certain axis."
    )
    parts = list[str]()
    for prop in motion.props:
        seen = 100 * (np.asarray(prop.seen) >= 3).mean()
        who = f"{len(prop.labels)} markers ({', '.join(prop.labels)})"
        facts = f"{who}, of which three or more are visible in {seen:.0f} % of the frames"
        curves = (
            (PlotCurve(1000 * prop.sigma[:, 0], "origin", "a"), "mm"),
            (PlotCurve(np.degrees(prop.sigma[:, 1]), "rotation", "b"), "°"),
        )
        plots = [time_plot([curve], motion.fps, unit, from_zero=True, size=(WIDTH, 120)) for curve, unit in curves]
        parts.append(f"<h3>{text(prop.name)}</h3><p>{text(facts)}</p>{''.join(plots)}")
    return section("Props", "".join(parts), lead, "props") if parts else ""


def calibration_section(capture: Capture, fit: CameraFits | None) -> str:
    """Show how well the calibration fits the take, if it was checked."""
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
    tilt = f"{number(fit.tilt_deg)}° ± {number(fit.tilt_sigma_deg)}°"
    stature = f"{number(fit.stature_m, 2)} m"
    world = facts(
        [("height according to the calibration", stature), ("tilt of the person from the world's up direction", tilt)]
    )
    lead = (
        f"Result of the check: {text(fit.verdict)}. The column <i>at best</i> shows the error after the camera "
        "poses were adjusted to the take. A camera whose error is far larger than this has probably moved. If the "
        "error is far larger at the edges than in the centre, the zoom may differ. If the epipolar distance grows, "
        "the camera may have been touched, or its clock may drift."
    )
    body = (
        f'<ul class="findings">{items}</ul><h3>Reprojection error by part of the image, px</h3>{table}'
        f"<h3>Distance to epipolar lines over the take, px</h3>{plot}<h3>The world</h3>{world}"
    )
    return section("Calibration", body, lead, "calibration")
