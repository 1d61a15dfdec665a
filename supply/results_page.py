"""Generate docs/results.md and its charts from the committed benchmark baseline."""

from __future__ import annotations

import json
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, Decimal
from functools import cache
from pathlib import Path

from supply.bar_chart import BarGroup, draw_bars

BASELINE = Path(__file__).resolve().parents[1] / "tests" / "benchmarks" / "baseline.json"
METHODS = ("ours", "MoSh++", "Barron", "noise-aware")
PRIORS = ("pose_ndf", "vposer", "rvposer", "rest")


@dataclass(frozen=True)
class ChartOfBars:
    """A bar chart of benchmark figures on the results page."""

    name: str
    title: str
    bench: str
    unit: str
    series: tuple[str, ...]
    groups: tuple[tuple[str, tuple[str, ...]], ...]
    """Label, then the key of a figure for each series."""


CHARTS = (
    ChartOfBars(
        "views", "Mean joint error by number of cameras (two simulated takes)", "bundle", "mm",
        ("this program", "BundleMoCap++", "frame by frame"),
        tuple(
            (f"{n} cameras", tuple(f"views_{n}_{method}_mpjpe_mm" for method in ("ours", "published", "muvs")))
            for n in (2, 3, 4, 8)
        ),
    ),
    ChartOfBars(
        "noise_aware", "Error with simulated markers under three kinds of noise (RMSE, twelve takes)", "noise_aware",
        "mm", METHODS,
        tuple((f"{n} noise", tuple(f"{n}_m_{m}_rmse_mm" for m in METHODS)) for n in ("data", "inference", "both")),
    ),
    ChartOfBars(
        "completion", "Error of joints completed by a pose prior (60 frames of recorded motion)", "pose_ndf", "cm",
        ("Pose-NDF", "VPoser", "RVPoser", "rest pose"),
        tuple(
            (limb.replace("_", " "), tuple(f"complete_60_{limb}_{prior}_cm" for prior in PRIORS))
            for limb in ("arm", "shoulder_upper_arm", "leg")
        ),
    ),
    ChartOfBars(
        "cameras", "Distance to the detections of a held-out camera (real recording)", "calibration", "px",
        ("median distance",),
        (
            ("original calibration", ("real_own_held_out_px",)),
            ("refined from the person", ("real_refined_held_out_px",)),
            ("calibrated from the person only", ("real_person_held_out_px",)),
        ),
    ),
)  # fmt: skip

TABLES: dict[str, tuple[tuple[str, str, str, str], ...]] = {
    "From several views": (
        ("Joint error with four views, three takes", "bundle", "mpjpe_mm", "mm"),
        ("Joint error with three views, two takes", "bundle", "views_3_ours_mpjpe_mm", "mm"),
        ("Joint error with two views, two takes", "bundle", "views_2_ours_mpjpe_mm", "mm"),
        ("Joint error relative to our BundleMoCap++, four views, three takes", "bundle", "mpjpe_ratio", ""),
        ("Solve time relative to our BundleMoCap++", "bundle", "seconds_ratio", ""),
        ("Keypoint error with exact detections, shapes outside the body model", "floor", "exact_points_mm", "mm"),
        ("Keypoint error with detector noise, shapes outside the body model", "floor", "noisy_points_mm", "mm"),
        ("Frames with a lost limb in twenty fast takes", "floor", "frames_with_a_lost_limb", "frames"),
        (
            "Error of people solved in pairs, relative to people solved alone, worst of ten pairs",
            "people",
            "against_alone",
            "",
        ),
        ("Median error of the estimated start times of four cameras started by hand", "sync", "median_error", "frames"),
        (
            "Corrected wrong calibrations, image orientations or names",
            "agreement",
            "static_good_percent",
            "%",
        ),
        ("Corrected pairs of these faults", "agreement", "two_good_percent", "%"),
        (
            "Cameras rotated, moved or from another take, corrected or harmless",
            "agreement",
            "unknown_good_percent",
            "%",
        ),
        ("Cameras late by 4 or 10 frames, corrected or harmless", "agreement", "delay_good_percent", "%"),
        ("All these cases with a second person 1.3 m away", "agreement", "company_good_percent", "%"),
        ("All these cases with random cameras", "random_rigs", "one_person_good_percent", "%"),
        ("The same with two people", "random_rigs", "two_people_good_percent", "%"),
        ("Cases with a wrong correction", "agreement", "all_wrong", "of 198 cases"),
        ("Cases with a wrong result and no warning", "agreement", "all_silent", "of 198 cases"),
    ),
    "From one calibrated camera": (
        ("Joint error in the world, unseen people 1.45 to 2.05 m tall", "one_camera_people", "world", "mm"),
        ("The same after similarity alignment of each frame", "one_camera_people", "pa", "mm"),
        ("Joint error in the world, dances unlike the training motion", "one_camera_people", "class_world", "mm"),
        ("The same after similarity alignment of each frame", "one_camera_people", "class_pa", "mm"),
        ("True joints inside the 95 % confidence ellipsoids, unseen people", "one_camera_people", "inside_95", "%"),
    ),
    "From optical markers": (
        ("Hidden-marker error relative to rigid-body filling, CMU", "markers", "cmu_41_mean_share", ""),
        ("Hidden-marker error relative to rigid-body filling, running", "markers", "running_53_mean_share", ""),
        (
            "Hidden-marker error relative to rigid-body filling, Plug-in Gait",
            "markers",
            "plug-in_gait_39_mean_share",
            "",
        ),
        (
            "Hidden-marker error relative to rigid-body filling, simulated markers",
            "markers",
            "synthetic_42_mean_share",
            "",
        ),
        ("True joints inside the 50 % confidence ellipsoids", "markers", "held50", "%"),
        ("True joints inside the 95 % confidence ellipsoids", "markers", "held95", "%"),
        (
            "Solve speed for a known person with 42 markers, on one core",
            "marker_speed",
            "known_person_a_core",
            "frames per second",
        ),
        ("Failed takes among the 474 takes in UI-PRMD", "markers_ui_prmd", "failed_takes", "takes"),
    ),
    "Hands": (
        ("Fingertip error with palms of about 40 px in four views (RMS)", "hands", "fingertips_rms_mm", "mm"),
        ("Bending error of knuckles and middle joints in these takes (RMS)", "hands", "flexion_rms_deg", "°"),
        ("True finger joints inside the 95 % confidence ellipsoids", "hands", "in_ellipsoids_percent", "%"),
        ("Bending error with 26 markers per hand (RMS)", "hands", "hand26_flexion_rms_deg", "°"),
        (
            "Bending error with 10 markers per hand, for hands in the training data (RMS)",
            "hands",
            "hand10_flexion_rms_deg",
            "°",
        ),
        ("Solve time for body and hands, relative to the body alone", "hands", "times_the_body_alone", ""),
        ("CPU time to find both hands in a picture", "hand_detection", "two_hands_ms", "ms"),
        (
            "Frames of the balancing videos where the right hand was found in at least two views",
            "hand_detection",
            "right_found_percent",
            "%",
        ),
    ),
    "Detections in videos": (
        (
            "Median distance between keypoints of the included detector and OpenPose, 448 pictures",
            "detector",
            "detected_px",
            "px",
        ),
        ("The same distance, relative to the person's height", "detector", "detected_percent", "%"),
        ("Keypoints missed by the included detector", "detector", "missing_percent", "%"),
        ("Limbs with swapped sides in the detections", "detector", "detected_swaps_percent", "%"),
        ("Limbs with swapped sides after the solve", "detector", "solved_swaps_percent", "%"),
        ("CPU time to decode a picture and detect keypoints, original videos", "detector", "cpu_ms", "ms"),
        ("Residual with four cameras calibrated without a board", "video_cameras", "four_px", "px"),
        ("Residual with the trial's own calibration", "video_cameras", "four_calibrated_px", "px"),
        ("Size error with four cameras calibrated without a board", "video_cameras", "four_size_percent", "%"),
        (
            "The same with a given stature",
            "video_cameras",
            "four_with_stature_size_percent",
            "%",
        ),
        ("Residual with the three cameras that give the worst result", "video_cameras", "three_px", "px"),
        ("Size error with the three cameras that give the worst result", "video_cameras", "three_size_percent", "%"),
        (
            "Detection speed with four cameras on two cores (wall-clock time, re-encoded videos)",
            "video_speed",
            "pictures_per_s_per_camera",
            "pictures per second per camera",
        ),
        ("Time from videos to motion, four cameras, 10 s at 30 frames per second", "video_speed", "take_s", "s"),
    ),
    "In Blender": (
        ("CPU time to bake 10,000 frames of 24 bones", "bake", "bake_cpu_s_10000_frames", "s"),
        ("Largest distance between joint positions in Blender and in the solver", "body", "joints_deviation_mm", "mm"),
        ("CPU time to retarget 1,000 frames", "retarget", "cpu_s_1000_frames", "s"),
        ("Additional CPU time when solving inside Blender", "solve_in_blender", "added_cpu_s", "s"),
    ),
}
"""Sections and their rows: description, benchmark, figure, unit."""
REAL = {
    "cmu_41_mean_share", "running_53_mean_share", "plug-in_gait_39_mean_share", "failed_takes",
    "hand26_flexion_rms_deg", "hand10_flexion_rms_deg", "two_hands_ms", "right_found_percent", "four_px",
    "four_calibrated_px", "four_size_percent", "four_with_stature_size_percent", "three_px", "three_size_percent",
    "pictures_per_s_per_camera", "take_s", "detected_px", "detected_percent", "missing_percent",
    "detected_swaps_percent", "solved_swaps_percent", "cpu_ms",
}  # fmt: skip
"""Figures from real recordings. Other figures are simulated, or only measure speed."""
SPEED = {"marker_speed", "bake", "body", "retarget", "solve_in_blender"}
"""Benchmarks that only measure speed, on any data."""

_HEAD = """<!-- Made by python3 dev.py docs from tests/benchmarks/baseline.json (dev.py bench --update records it). -->

# Results

To repeat a benchmark, run `python3 dev.py bench NAME`. We used one machine ({machine}). Only `bake`, `body`,
`solve_in_blender` and `marker_speed` run without recordings. The other benchmarks look for recordings in the folder
given by the variable `MOCAP_SHARED_DATA`, or in `shared/data` next to the repository, and print `skipped` if there are
none. Most recordings are copies of public data (CMU, UI-PRMD, Pose2Sim, BTKData, nimblephysics and others) in our own
file layout, for which there is no converter. The [model cards](explanation/body-and-patents.md#weights) list their
sources.

**Most figures are simulated.** *Simulated* means that recorded motion was applied to generated bodies, which
simulated cameras or sensors then recorded. The detector noise was measured on 100 frames of a real OpenPose
recording. *Real* means recorded markers or videos. The other methods in the comparisons are our own implementations.
The fault cases in *From several views* are held-out captures with one or two faults. A fault counts as harmless if the
error grows by at most 15 %. [Accuracy](explanation/accuracy.md) explains the measures.

The figures were measured between {first} and {last}. Some are older than the current search for wrong
calibrations. The [research log](research-log/README.md) has later figures."""


def results_page() -> str:
    """Return the results page."""
    dates = sorted(_recorded(bench, key) for rows in TABLES.values() for _, bench, key, _ in rows)
    parts = [_HEAD.format(machine=_baseline()["bundle"]["machine"], first=dates[0], last=dates[-1])]
    for title, rows in TABLES.items():
        parts += [
            "",
            f"## {title}",
            "",
            "| measurement | data | result | benchmark |",
            "|---|---|---|---|",
        ]
        for what, bench, key, unit in rows:
            data = "real" if key in REAL else "–" if bench in SPEED else "simulated"
            shown, gap = _show(bench, key), "" if unit in ("", "°") else " "
            one = unit.removesuffix("s") if shown == "1" and unit == "cases" else unit
            parts.append(f"| {what} | {data} | {shown}{gap}{one} | `{bench}` |")
    parts += ["", "## Charts"]
    for chart in CHARTS:
        parts += ["", f"### {chart.title}", "", f"![Chart](images/results_{chart.name}.svg)", ""]
        parts += [f"Measured with `python3 dev.py bench {chart.bench}` on {_baseline()[chart.bench]['recorded']}."]
    return "\n".join([*parts, ""])


def draw_chart(chart: ChartOfBars) -> str:
    """Draw a chart of the results page as SVG."""
    groups = tuple(BarGroup(label, tuple(_figure(chart.bench, key) for key in keys)) for label, keys in chart.groups)
    return draw_bars(chart.title, chart.unit, chart.series, groups)


@cache
def _baseline() -> dict:
    return json.loads(BASELINE.read_text(encoding="utf-8"))


def _recorded(bench: str, key: str) -> str:
    """Return the date of a figure, or of its benchmark."""
    found = _baseline()[bench]
    return found["figures"].get(key, {}).get("recorded", found["recorded"])


def _figure(bench: str, key: str) -> float:
    return float(_baseline()[bench]["figures"][key]["value"])


def _show(bench: str, key: str) -> str:
    value = Decimal(str(_figure(bench, key)))
    places = 0 if value >= 100 or value == int(value) else 1 if value >= 10 else 2
    return f"{value.quantize(Decimal(1).scaleb(-places), ROUND_HALF_UP):,}"
