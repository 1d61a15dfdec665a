"""What a solve of markers shows of itself: how far the body is from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.label_choice import limb_of, of_one_limb
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.runs import true_runs
from solver_backend.types import MARKER_GHOST, Capture, Motion

FAR_MM, CENTRES_FAR_MM = 10.0, 30.0
"""Median residual of markers and of joint centres that is doubted: 60 recordings of other laboratories have 0.1 to 5
(7 where a network named the points), 3D keypoints of networks up to 25."""
ALWAYS_MM, WHILE_MM, WHILE_S = 20.0, 50.0, 0.3
"""Median residual of one marker, and that of some frames and how long these last, from which on its label or place is
doubted: of 60 recordings those that look right have medians up to 19, and 50 for 0.24 s at most."""
STANDS_OUT = 2.0
"""A marker that is far stands out where its residual is so many times the take's."""
_WAIST = ("LFWT", "RFWT", "LBWT", "RBWT")
_HIPS = (("=pelvis",), ("~mid_hip",), ("=left_hip", "=right_hip"), ("~left_hip", "~right_hip"), _WAIST, _WAIST[:2])
HIPS_STILL_M, HIPS_BESIDE_M = 2e-4, 0.1
"""Metres by which the middle of hips moves at most where positions are relative to it, as far as files round; and by
which some other point moves then."""
USELESS = 5.0
"""So many times as far is a result useless."""


def marker_plausibility(motion: Motion) -> Iterator[Diagnostic]:
    """Yield what makes a solve of markers doubtful or useless."""
    error = motion.marker_residual_mm
    if error is None or motion.marker_labels is None or not isinstance(motion.provenance.get("markers"), list):
        return
    centres = centres_of(motion)
    size, limit = float(quantile(error[np.isfinite(error)], 0.5, axis=0)), CENTRES_FAR_MM if centres else FAR_MM
    if size > limit:
        severity, kind = useless(size > USELESS * limit), "joint centres" if centres else "markers"
        yield diagnostic("markers_far", severity=severity, size=size, limit=limit, kind=kind)
    yield from _far_markers(motion, size, limit / FAR_MM)
    yield from _side_by_name(motion.layout or ())


def _side_by_name(places: tuple[str, ...]) -> Iterator[Diagnostic]:
    """Yield that nothing but its labels shows of which side a limb alone is; a leg with its ankle shows it."""
    named = [place for place in places if place[:1] in ("L", "R") and not is_joint_centre(place)]
    if len(named) < len(places) or not of_one_limb(named, load_layouts()):
        return
    side, arm = named[0][0], any(limb_of(place, load_layouts()) == "arm" for place in named)
    if arm or not {side + place for place in ("ANK", "HEE", "TOE")} <= set(named):
        yield diagnostic(
            "limb_side_found", basis="label", side="left" if side == "L" else "right", limb="arm" if arm else "leg"
        )


def useless(is_useless: bool) -> Severity:
    """Return an error, which refuses the result, or a warning."""
    return Severity.ERROR if is_useless else Severity.WARNING


def centres_of(motion: Motion) -> bool:
    """Return whether a motion was solved from joint centres."""
    places = motion.provenance.get("markers")
    return isinstance(places, list) and any(is_joint_centre(str(place)) for place in places)


def hips_never_move(capture: Capture, motion: Motion) -> bool:
    """Return whether the middle of pelvis or hips is at one place in all frames while other points move."""
    cloud = capture.markers
    if cloud is None or cloud.labels is None or motion.marker_labels is None or motion.layout is None:
        return False
    label_of = dict(zip(motion.layout, motion.marker_labels, strict=True))
    spans = np.ptp(cloud.positions, axis=0).max(-1) if len(cloud.positions) > 1 else np.zeros(0)
    if not (spans > HIPS_BESIDE_M).any():
        return False
    for places in _HIPS:
        columns = [cloud.labels.index(label_of[name]) for name in places if label_of.get(name) in cloud.labels]
        if len(columns) == len(places):
            middle = cloud.positions[:, columns].mean(axis=1)
            middle = middle[np.isfinite(middle).all(-1)]
            if len(middle) > 1 and np.ptp(middle, axis=0).max() < HIPS_STILL_M:
                return True
    return False


def _far_markers(motion: Motion, usual: float, scale: float) -> Iterator[Diagnostic]:
    """Yield which markers are far from where the body has them, always or for a while.

    Args:
        motion: solved from markers.
        usual: median residual of the take, millimetres.
        scale: of the limits.
    """
    assert motion.marker_residual_mm is not None and motion.marker_labels is not None
    thrown_out = 0 if motion.marker_flags is None else motion.marker_flags & MARKER_GHOST
    error = np.where(thrown_out, np.nan, motion.marker_residual_mm)
    always, least = quantile(error, 0.5, axis=0), max(scale * ALWAYS_MM, STANDS_OUT * usual)
    for m in np.argsort(-np.nan_to_num(always)):
        label, far = motion.marker_labels[int(m)], np.nan_to_num(error[:, m]) > scale * WHILE_MM
        if always[m] > least:
            yield diagnostic("marker_far", markers=[label], size=always[m])
        elif runs := [run for run in true_runs(far) if run[1] + 1 - run[0] >= WHILE_S * motion.fps]:
            largest = max(float(np.nanmax(error[a : b + 1, m])) for a, b in runs)
            yield diagnostic("marker_far", markers=[label], frames=runs, size=largest)
