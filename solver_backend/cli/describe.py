"""Describe a capture or a motion, both as text and as plain values."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.cli.outcome import found_data, rows
from solver_backend.exchange.verb_results import CaptureSummary, MotionSummary, PersonSummary
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, Capture, Motion


def describe_capture(capture: Capture) -> tuple[str, CaptureSummary]:
    """Describe a capture's cameras, frames, people and problems, as text and as JSON values."""
    duration_s = round(capture.num_frames / capture.fps, 3) if capture.fps else None
    data = CaptureSummary(
        name=capture.name, frames=capture.num_frames, fps=capture.fps, duration_s=duration_s, joint_set=None,
        markers=None, cameras=_cameras(capture), people=describe_people(capture), person=capture.person,
        truth=sorted(capture.truth), **found_data((*capture.problems, *capture.notes)),
    )  # fmt: skip
    if capture.keypoints is not None:
        data["joint_set"] = capture.keypoints.joint_set.value
        data["own_points"] = {point.name: point.bone for point in capture.keypoints.own}
        data["bridged_frames"] = frames_without_two_views(capture)
    marker_lines: list[str] = []
    if capture.markers is not None:
        from solver_backend.cli.describe_markers import describe_markers

        data["markers"] = int(capture.markers.positions.shape[1])
        marker_lines, data["marker_names"] = describe_markers(capture.markers)
    return _capture_text(data, marker_lines), data


def describe_motion(motion: Motion, solve_s: float) -> tuple[str, MotionSummary]:
    """Describe a motion's length, residuals and uncertain frames, as text and as JSON values.

    ``solve_s`` is the duration of the solve in seconds.
    """
    flags = np.zeros(motion.num_frames, np.uint8) if motion.flags is None else motion.flags
    unseen, unsure = (int(np.count_nonzero(flags & bit)) for bit in (FLAG_UNSEEN, FLAG_UNSURE))
    data = MotionSummary(
        frames=motion.num_frames, fps=motion.fps, duration_s=round(motion.num_frames / motion.fps, 3),
        solve_s=round(solve_s, 2), reprojection_median_px=_median(motion.reprojection_px), unseen_frames=unseen,
        marker_median_mm=_median(motion.marker_residual_mm), unsure_frames=unsure,
    )  # fmt: skip
    residual, measured = f"{data['reprojection_median_px']} px", "detections"
    if motion.markers is not None and motion.reprojection_px is None:
        residual, measured = f"{data['marker_median_mm']} mm", "markers"
    lines = [
        f"Solved {data['frames']} frames, {data['duration_s']:.1f} s at {motion.fps:g} frames per second, "
        f"in {solve_s:.1f} s",
        f"  residual    {residual} (median)",
        f"  to look at  {data['unsure_frames']} frames far from the {measured} or very uncertain, "
        f"{data['unseen_frames']} interpolated",
    ]
    if motion.props:
        data["props"] = [prop.name for prop in motion.props]
        lines += rows("props", ", ".join(data["props"]))
    return "\n".join(lines), data


def _median(errors: np.ndarray | None) -> float | None:
    finite = np.empty(0) if errors is None else errors[np.isfinite(errors)]
    return round(float(np.median(finite)), 3) if finite.size else None


def describe_people(capture: Capture) -> list[PersonSummary]:
    """Summarise the frames and the number of cameras in which each person in a capture is visible."""
    people: list[PersonSummary] = []
    for person in capture.people:
        frames = np.flatnonzero(person.agreed)
        seen = (person.keypoints.confidence > 0).any(axis=-1)
        views = round(float(seen[:, frames].sum(axis=0).mean()), 2) if len(frames) else 0.0
        first, last = (int(frames[0]), int(frames[-1])) if len(frames) else (None, None)
        share = [round(100 * float(part), 1) for part in seen.mean(axis=1)]
        people.append(
            PersonSummary(name=person.name, frames=len(frames), first=first, last=last, views=views, seen_percent=share)
        )
    return people


def people_lines(people: list[PersonSummary]) -> list[str]:
    """Describe each person in a capture in one line of text."""
    return [
        f"  person      {person['name']}: {person['views']:.1f} views in {person['frames']} frames, "
        f"{person['first']}-{person['last']}"
        for person in people
    ]


def frames_without_two_views(capture: Capture) -> list[list[int]]:
    """Return the frame ranges in which no keypoint is detected by two cameras, or by the only camera."""
    return [list(run) for run in true_runs(~capture.placed.any(axis=-1))]


def _cameras(capture: Capture) -> list[dict[str, Any]]:
    cameras, found = capture.cameras, list[dict[str, Any]]()
    for c, name in enumerate(() if cameras is None else cameras.names):
        assert cameras is not None
        seen = None if capture.keypoints is None else float((capture.keypoints.confidence[c] > 0).mean())
        footage = capture.footage[c] if c < len(capture.footage) else None
        place = {"image_size": cameras.image_size[c].tolist(), "position_m": cameras.centres[c].round(3).tolist()}
        share = None if seen is None else round(100 * seen, 1)
        found.append({"name": name, **place, "seen_percent": share, "footage": str(footage) if footage else None})
    return found


def _capture_text(data: CaptureSummary, marker_lines: list[str]) -> str:
    seconds = f" ({data['duration_s']:g} s)" if data["duration_s"] is not None else ""
    lines = [f"Capture {data['name']}", f"  frames      {data['frames']} at {data['fps']:g} fps{seconds}"]
    if data["joint_set"]:
        lines.append(f"  keypoints   {data['joint_set']}")
    if points := data.get("own_points"):
        own = ", ".join(f"{name} on {bone}" for name, bone in points.items())
        lines.append(f"  own points  {own}")
    lines += marker_lines + people_lines(data["people"])
    for camera in data["cameras"]:
        width, height = camera["image_size"]
        seen = "" if camera["seen_percent"] is None else f", sees {camera['seen_percent']:.0f} % of the keypoints"
        at = ", ".join(f"{v:.2f}" for v in camera["position_m"])
        footage = ", footage" if camera["footage"] else ""
        lines.append(f"  camera      {camera['name']}: {width} x {height} at ({at}) m{seen}{footage}")
    if data["truth"]:
        lines.append(f"  truth       {', '.join(data['truth'])}")
    seen_by = "the camera" if len(data["cameras"]) == 1 else "two cameras"
    gaps = [f"{first}-{last}" for first, last in data.get("bridged_frames", [])]
    if gaps:
        where = f"no person is seen by {seen_by} in frames {', '.join(gaps)}"
        lines.append(f"  {where}. They will be interpolated and flagged")
    lines += rows("note", *data["notes"])
    lines += rows("problem", *data["problems"]) or rows("problems", "none")
    return "\n".join(lines)
