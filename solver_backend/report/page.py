"""Write the report page of a solve: key figures and sections."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from pathlib import Path

import numpy as np

from solver_backend.evaluation.evaluate import evaluate
from solver_backend.exchange.diagnostics import word
from solver_backend.exchange.marker_formats import REPORT_MARK
from solver_backend.exchange.outputs import write_text
from solver_backend.geometry.arrays import quantile
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from solver_backend.report import sections
from solver_backend.report.biomechanics import biomechanics_sections
from solver_backend.report.body_pictures import poses_section, rest_pose_section
from solver_backend.report.body_sections import hands_section, one_view_section
from solver_backend.report.checks import diagnose, recorded_diagnostics
from solver_backend.report.markup import Tile, number, text, tiles
from solver_backend.report.sections import calibration_section, props_section
from solver_backend.report.statistics import KeypointResiduals, located_share, residuals_of, seen_by_views
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, Capture, Motion
from solver_backend.types.cameras import CameraFits


def write_report(
    path: Path | str,
    capture: Capture,
    motion: Motion,
    calibration: CameraFits | None = None,
    *,
    overwrite: bool = False,
) -> Path:
    """Write a self-contained HTML page about a solve, completely or not at all."""
    return write_text(path, report_html(capture, motion, calibration), overwrite=overwrite)


def report_html(capture: Capture, motion: Motion, calibration: CameraFits | None = None) -> str:
    """Return the report page of a solve as HTML. With ``calibration``, it includes the camera check.

    Raises:
        MotionInvalid: the motion does not belong to the capture.
    """
    capture = capture.named
    residuals = residuals_of(capture, motion)
    knows_truth = "joints" in capture.truth and motion.beside_truth(np.asarray(capture.truth["joints"]))[2]
    truth_lines = evaluate(capture, motion).lines() if knows_truth else []
    found = diagnose(capture, motion, residuals)
    body = [
        sections.diagnostics_section(found, motion.fps),
        poses_section(motion),
        one_view_section(capture, motion),
        sections.truth_section(capture, motion, truth_lines),
        sections.residual_sections(motion, residuals),
        sections.missing_section(capture, motion),
        sections.gaps_section(motion),
        sections.marker_section(motion),
        hands_section(motion),
        props_section(motion),
        rest_pose_section(motion),
        sections.reprojection_section(capture, residuals),
        calibration_section(capture, calibration),
        sections.angles_section(capture, motion),
        biomechanics_sections(motion),
        sections.uncertainty_section(motion),
        sections.scene_section(capture, motion),
        sections.provenance_section(capture, motion),
    ]
    headline = tiles(headline_tiles(capture, motion, residuals))
    whose = f", {capture.person}" if capture.person else ""
    return page_of(f"Solve of {text(capture.name + whose)}", text(_subtitle(capture, motion)), headline + "".join(body))


def page_of(title: str, subtitle: str, body: str) -> str:
    """Combine HTML parts into a complete page."""
    style, script = _part("page.css"), _part("page.js")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(style, script)}">{REPORT_MARK}'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{title}</title><style>{style}</style></head><body><main><h1>{title}</h1>"
        f'<p class="sub">{subtitle}</p>{body}</main>'
        f"<script>{script}</script></body></html>\n"
    )


def _policy(style: str, script: str) -> str:
    """Return a Content Security Policy with only the page's style and script, and no requests.

    All ``style`` attributes are allowed, because they store the tints of table cells, and hashes cannot allow them.
    """
    hashes = [b64encode(sha256(part.encode()).digest()).decode() for part in (style, script)]
    return (
        f"default-src 'none'; style-src-elem 'sha256-{hashes[0]}'; style-src-attr 'unsafe-inline'; "
        f"script-src 'sha256-{hashes[1]}'; base-uri 'none'; form-action 'none'"
    )


def _part(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def headline_tiles(capture: Capture, motion: Motion, residuals: KeypointResiduals | None) -> list[Tile]:
    """Return the key figures at the top of a solve's report page."""
    flags = np.zeros(motion.num_frames, np.uint8) if motion.flags is None else motion.flags
    unsure, unseen = (int(np.count_nonzero(flags & bit)) for bit in (FLAG_UNSURE, FLAG_UNSEEN))
    found = []
    solved, truth, names = motion.beside_truth(capture.truth.get("joints", np.zeros(0)))
    if names:
        accel = accel_error_m_s2(solved, truth, motion.fps)
        note = f"mean of {len(names)} joints, acceleration {number(accel, 2)} m/s²"
        found.append(Tile("Error against the truth", number(mpjpe_mm(solved, truth)), "mm", note))
    if residuals is not None:
        found.append(Tile("Reprojection error", number(residuals.median_px), "px", "median of all detections"))
        agreement = float(residuals.agreement_percent((0, 1, 2)))
        note, level = "of the detections are not outliers", _level(agreement, 90, 75)
        found.append(Tile("View agreement", number(agreement, 0), "%", note, level))
    if motion.marker_residual_mm is not None:
        error = motion.marker_residual_mm.ravel()
        middle, most = (number(float(quantile(error, q, axis=0))) for q in (0.5, 0.95))
        found.append(Tile("Marker residual", middle, "mm", f"median of all markers, 95 % are below {most} mm"))
        share = 100 * float(np.isfinite(error).mean())
        found.append(Tile("Markers seen", number(share, 0), "%", "of all markers and frames", _level(share, 90, 70)))
    for item in recorded_diagnostics(motion):
        if item.code == "stature_solved":
            found.append(Tile("Stature", number(float(item.values["size"]), 2), "m", word(item).what))
    located = located_share(capture)
    if located is not None:
        share = 100 * float(located.mean())
        found.append(Tile(seen_by_views(capture), number(share, 0), "%", "of the keypoints", _level(share, 90, 70)))
    why = f"{sections.far_from(motion)} or very uncertain"
    found.append(Tile("Frames to check", str(unsure), "", why, "look" if unsure else "good"))
    why = sections.why_interpolated(motion)
    found.append(Tile("Interpolated frames", str(unseen), "", why, "bad" if unseen else "good"))
    seconds = motion.provenance.get("solve_s")
    if isinstance(seconds, int | float) and seconds > 0:
        found.append(Tile("Solve time", number(seconds), "s", f"{motion.num_frames / seconds:.0f} frames per second"))
    return found


def _level(value: float, good: float, fair: float) -> str:
    return "good" if value >= good else "look" if value >= fair else "bad"


def _subtitle(capture: Capture, motion: Motion) -> str:
    views = f"{len(capture.cameras)} cameras, " if capture.cameras is not None else ""
    points = f", {capture.keypoints.joint_set.value}" if capture.keypoints is not None else ""
    points += "" if motion.marker_labels is None else f", {len(motion.marker_labels)} markers"
    keys = "" if motion.keyframes is None else f", {int(np.count_nonzero(motion.keyframes))} keyframes"
    version = motion.provenance.get("solver", "")
    length = f"{motion.num_frames} frames at {motion.fps:g} fps ({motion.num_frames / motion.fps:.1f} s)"
    return f"{views}{length}{points}{keys}. Manifold MoCap {version}".strip()
