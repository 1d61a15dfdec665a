"""A capture or a motion in words and in plain values."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.verb_results import CameraSummary, CaptureSummary, MotionSummary, PersonSummary
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, Capture, Motion


def describe_capture(capture: Capture) -> tuple[str, CaptureSummary]:
    """Return text and JSON values: cameras, frames, keypoints, markers, who is seen where, notes and problems."""
    data: CaptureSummary = {
        "name": capture.name, "frames": capture.num_frames, "fps": capture.fps,
        "duration_s": round(capture.num_frames / capture.fps, 3) if capture.fps else None,
        "cameras": _cameras(capture), "joint_set": None, "markers": None,
        "people": describe_people(capture), "person": capture.person,
        "truth": sorted(capture.truth), "notes": [sentence(item) for item in capture.notes],
        "problems": [sentence(item) for item in capture.problems],
        "diagnostics": [item.as_dict() for item in (*capture.problems, *capture.notes)],
    }  # fmt: skip
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
    """Return text and JSON values: length, residual and the frames that deserve a look."""
    error = (
        np.empty(0) if motion.reprojection_px is None else motion.reprojection_px[np.isfinite(motion.reprojection_px)]
    )
    marker_error = np.empty(0) if motion.marker_residual_mm is None else motion.marker_residual_mm
    marker_error = marker_error[np.isfinite(marker_error)]
    flags = np.zeros(motion.num_frames, np.uint8) if motion.flags is None else motion.flags
    data: MotionSummary = {
        "frames": motion.num_frames, "fps": motion.fps, "duration_s": round(motion.num_frames / motion.fps, 3),
        "solve_s": round(solve_s, 2),
        "reprojection_median_px": round(float(np.median(error)), 3) if error.size else None,
        "marker_median_mm": round(float(np.median(marker_error)), 3) if marker_error.size else None,
        "unseen_frames": int(np.count_nonzero(flags & FLAG_UNSEEN)),
        "unsure_frames": int(np.count_nonzero(flags & FLAG_UNSURE)),
    }  # fmt: skip
    residual, measured = (data["reprojection_median_px"], "px"), "detections"
    if motion.markers is not None and motion.reprojection_px is None:
        residual, measured = (data["marker_median_mm"], "mm"), "markers"
    lines = [
        f"Solved {data['frames']} frames, {data['duration_s']:.1f} s at {motion.fps:g} frames a second, "
        f"in {solve_s:.1f} s",
        f"  residual    {residual[0]} {residual[1]} (median)",
        f"  to look at  {data['unsure_frames']} frames far from the {measured} or hardly known, "
        f"{data['unseen_frames']} bridged",
    ]
    if motion.props:
        data["props"] = [prop.name for prop in motion.props]
        lines.append(f"  props       {', '.join(data['props'])}")
    return "\n".join(lines), data


def describe_people(capture: Capture) -> list[PersonSummary]:
    """Return name, agreed frames, first and last of them, and the views that see each person, of several people."""
    people: list[PersonSummary] = []
    for person in capture.people:
        frames = np.flatnonzero(person.agreed)
        seen = (person.keypoints.confidence > 0).any(axis=-1)
        share = seen.mean(axis=1)
        people.append(
            {
                "name": person.name, "frames": len(frames),
                "first": int(frames[0]) if len(frames) else None, "last": int(frames[-1]) if len(frames) else None,
                "views": round(float(seen[:, frames].sum(axis=0).mean()), 2) if len(frames) else 0.0,
                "seen_percent": [round(100 * float(part), 1) for part in share],
            }
        )  # fmt: skip
    return people


def people_lines(people: list[PersonSummary]) -> list[str]:
    """Return a line of text on each person."""
    return [
        f"  person      {person['name']}: {person['views']:.1f} views in {person['frames']} frames, "
        f"{person['first']}-{person['last']}"
        for person in people
    ]


def frames_without_two_views(capture: Capture) -> list[list[int]]:
    """Return [first, last] of each range of frames in which no keypoint is seen by two cameras, or by the only one."""
    assert capture.keypoints is not None
    least = 1 if capture.is_one_view else 2
    blind = ~((capture.keypoints.confidence > 0).sum(axis=0) >= least).any(axis=-1)
    return [list(run) for run in true_runs(blind)]


def _cameras(capture: Capture) -> list[CameraSummary]:
    """Return what each camera is and the share of keypoints it sees, in percent."""
    cameras = capture.cameras
    if cameras is None:
        return []
    seen = None if capture.keypoints is None else (capture.keypoints.confidence > 0).mean(axis=(1, 2))
    return [
        {
            "name": name, "image_size": cameras.image_size[c].tolist(),
            "position_m": [round(float(v), 3) for v in cameras.centres[c]],
            "seen_percent": None if seen is None else round(100 * float(seen[c]), 1),
            "footage": str(capture.footage[c]) if c < len(capture.footage) and capture.footage[c] else None,
        }
        for c, name in enumerate(cameras.names)
    ]  # fmt: skip


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
        lines.append(f"  nobody is seen by {seen_by} in frames {', '.join(gaps)}; they will be bridged and flagged")
    lines += [f"  note        {note}" for note in data["notes"]]
    lines += [f"  problem     {problem}" for problem in data["problems"]] or ["  problems    none"]
    return "\n".join(lines)
