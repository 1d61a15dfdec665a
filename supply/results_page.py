"""Generate docs/results.md and its charts from the committed benchmark baseline, so that no figure is typed by hand."""

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
    """A chart of the page: its texts, and the figures of a benchmark that it shows."""

    name: str
    title: str
    bench: str
    unit: str
    series: tuple[str, ...]
    groups: tuple[tuple[str, tuple[str, ...]], ...]
    """Label, then the key of a figure for each series."""


CHARTS = (
    ChartOfBars(
        "views", "Mean joint error by number of cameras, simulated, two takes", "bundle", "mm",
        ("this program", "BundleMoCap++", "frame by frame"),
        tuple(
            (f"{n} cameras", tuple(f"views_{n}_{method}_mpjpe_mm" for method in ("ours", "published", "muvs")))
            for n in (2, 3, 4, 8)
        ),
    ),
    ChartOfBars(
        "noise_aware", "Error of simulated markers under three kinds of noise, twelve takes (RMSE)", "noise_aware",
        "mm", METHODS,
        tuple((f"{n} noise", tuple(f"{n}_m_{m}_rmse_mm" for m in METHODS)) for n in ("data", "inference", "both")),
    ),
    ChartOfBars(
        "completion", "Error of joints filled in by a pose prior, recorded motion, 60 frames", "pose_ndf", "cm",
        ("Pose-NDF", "VPoser", "RVPoser", "rest pose"),
        tuple(
            (limb.replace("_", " "), tuple(f"complete_60_{limb}_{prior}_cm" for prior in PRIORS))
            for limb in ("arm", "shoulder_upper_arm", "leg")
        ),
    ),
    ChartOfBars(
        "cameras", "Distance to the detections of an excluded camera, real recording", "calibration", "px",
        ("median distance",),
        (
            ("original calibration", ("real_own_held_out_px",)),
            ("refined from the person", ("real_refined_held_out_px",)),
            ("made from the person alone", ("real_person_held_out_px",)),
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
        ("Keypoint error with exact detections, bodies outside our shape space", "floor", "exact_points_mm", "mm"),
        ("Keypoint error with detector noise, bodies outside our shape space", "floor", "noisy_points_mm", "mm"),
        ("Frames with a lost limb in twenty fast takes", "floor", "frames_with_a_lost_limb", "frames"),
        ("Error of people solved in pairs relative to people alone, worst of ten pairs", "people", "against_alone", ""),
        ("Median error of the estimated clocks of four cameras started by hand", "sync", "median_error", "frames"),
        ("Corrected cases with a wrong calibration, picture or name", "agreement", "static_good_percent", "%"),
        ("Corrected cases with two such faults", "agreement", "two_good_percent", "%"),
        (
            "Corrected or harmless cases with a rotated or moved camera, or a camera of another take",
            "agreement",
            "unknown_good_percent",
            "%",
        ),
        ("Corrected or harmless cases with a late camera (4 or 10 frames)", "agreement", "delay_good_percent", "%"),
        (
            "Corrected or harmless cases with these camera faults and two people close together",
            "agreement",
            "company_good_percent",
            "%",
        ),
        ("Cases with a wrong correction", "agreement", "all_wrong", "of 198 cases"),
        ("Cases with a wrong result and no warning", "agreement", "all_silent", "of 198 cases"),
    ),
    "From one calibrated camera": (
        ("Joint error in the world, unseen people of 1.45 to 2.05 m", "one_camera_people", "world", "mm"),
        ("The same after similarity alignment of each frame", "one_camera_people", "pa", "mm"),
        ("Joint error in the world, dances unlike the training motion", "one_camera_people", "class_world", "mm"),
        ("The same after similarity alignment of each frame", "one_camera_people", "class_pa", "mm"),
        ("True joints inside the 95 % confidence ellipsoids, unseen people", "one_camera_people", "inside_95", "%"),
    ),
    "From optical markers": (
        ("Error of hidden markers relative to rigid-body filling, CMU", "markers", "cmu_41_mean_share", ""),
        ("Error of hidden markers relative to rigid-body filling, running", "markers", "running_53_mean_share", ""),
        (
            "Error of hidden markers relative to rigid-body filling, Plug-in Gait",
            "markers",
            "plug-in_gait_39_mean_share",
            "",
        ),
        (
            "Error of hidden markers relative to rigid-body filling, simulated markers",
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
        ("Failed takes among the 474 takes of UI-PRMD", "markers_ui_prmd", "failed_takes", "takes"),
    ),
    "Hands": (
        ("Fingertip error, palms of 40 px in four views (RMS)", "hands", "fingertips_rms_mm", "mm"),
        ("Bend error of knuckles and middle joints in these takes (RMS)", "hands", "flexion_rms_deg", "°"),
        ("True finger joints inside the 95 % confidence ellipsoids", "hands", "in_ellipsoids_percent", "%"),
        ("Bend error with 26 markers per hand (RMS)", "hands", "hand26_flexion_rms_deg", "°"),
        ("Bend error with 10 markers per hand, hands of the training (RMS)", "hands", "hand10_flexion_rms_deg", "°"),
        ("Solve time of body and hands relative to the body alone", "hands", "times_the_body_alone", ""),
        ("CPU time to find both hands in a picture", "hand_detection", "two_hands_ms", "ms"),
        (
            "Frames of the balancing videos with the right hand in at least two views",
            "hand_detection",
            "right_found_percent",
            "%",
        ),
    ),
    "Detections in videos": (
        (
            "Median distance of the included detector from OpenPose's keypoints, 448 pictures",
            "detector",
            "detected_px",
            "px",
        ),
        ("The same distance relative to the person's height", "detector", "detected_percent", "%"),
        ("Keypoints missed by the included detector", "detector", "missing_percent", "%"),
        ("Limbs with swapped sides in the detections", "detector", "detected_swaps_percent", "%"),
        ("Limbs with swapped sides after the solve", "detector", "solved_swaps_percent", "%"),
        ("CPU time to decode a picture and detect keypoints, original videos", "detector", "cpu_ms", "ms"),
        ("Residual with four cameras calibrated without a board", "video_cameras", "four_px", "px"),
        ("Residual with the calibration of the trial", "video_cameras", "four_calibrated_px", "px"),
        ("Size error with four cameras calibrated without a board", "video_cameras", "four_size_percent", "%"),
        (
            "The same with a given stature",
            "video_cameras",
            "four_with_stature_size_percent",
            "%",
        ),
        ("Residual with the worst three of these cameras", "video_cameras", "three_px", "px"),
        ("Size error with the worst three of these cameras", "video_cameras", "three_size_percent", "%"),
        (
            "Detection speed with four cameras on two cores, real time, re-encoded videos",
            "video_speed",
            "pictures_per_s_per_camera",
            "pictures per second and camera",
        ),
        ("Time from videos to motion, four cameras, 10 s at 30 pictures per second", "video_speed", "take_s", "s"),
    ),
    "In Blender": (
        ("CPU time to bake 10,000 frames of 24 bones", "bake", "bake_cpu_s_10000_frames", "s"),
        ("Largest distance between the joints in Blender and in the solver", "body", "joints_deviation_mm", "mm"),
        ("CPU time to retarget 1,000 frames", "retarget", "cpu_s_1000_frames", "s"),
        ("Additional CPU time of a solve inside Blender", "solve_in_blender", "added_cpu_s", "s"),
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
"""Figures of real recordings. The others are simulated, or only measure speed."""
SPEED = {"marker_speed", "bake", "body", "retarget", "solve_in_blender"}
"""Benchmarks that only measure speed, on any data."""

_HEAD = """<!-- Made by python3 dev.py docs from tests/benchmarks/baseline.json (dev.py bench --update records it). -->

# Results

Run `python3 dev.py bench NAME` to measure the figures of a benchmark again. The machine has {machine}.
Only `bake`, `body`, `solve_in_blender` and `marker_speed` need no recordings. The others need recordings
in the folder that the variable `MOCAP_SHARED_DATA` names, or in `shared/data` next to the repository, and print
`skipped` without them. Most are copies of public ones (CMU, UI-PRMD, Pose2Sim, BTKData, nimblephysics and others) in
our own file layout, for which there is no converter. The [model cards](explanation/body-and-patents.md#weights) name
sources.

**Most figures are simulated.** *Simulated* means that simulated cameras or sensors recorded generated bodies with
recorded motion. The detector's noise was measured on 100 frames of a real recording with OpenPose. *Real* means
recorded markers or videos. Other methods are our own implementations. The cases in *From several views* are held-out
captures with one or two faults. A fault is harmless if the error grows by at most 15 %. The search for wrong
calibrations has changed since some rows were measured. The [research log](research-log/README.md) has later figures.
[Accuracy](explanation/accuracy.md) explains the measures."""


def results_page() -> str:
    """Return docs/results.md."""
    parts = [_HEAD.format(machine=_baseline()["bundle"]["machine"])]
    for title, rows in TABLES.items():
        parts += [
            "",
            f"## {title}",
            "",
            "| measurement | data | result | benchmark | measured on |",
            "|---|---|---|---|---|",
        ]
        for what, bench, key, unit in rows:
            data = "real" if key in REAL else "–" if bench in SPEED else "simulated"
            # A figure that was not measured again with its benchmark has a date of its own.
            found = _baseline()[bench]
            made = f"`{bench}` | {found['figures'].get(key, {}).get('recorded', found['recorded'])}"
            shown, gap = _show(bench, key), "" if unit in ("", "°") else " "
            one = unit.removesuffix("s") if shown == "1" and unit == "cases" else unit
            parts.append(f"| {what} | {data} | {shown}{gap}{one} | {made} |")
    parts += ["", "## Charts"]
    for chart in CHARTS:
        parts += ["", f"### {chart.title}", "", f"![Chart](images/results_{chart.name}.svg)", ""]
        parts += [f"Measured with `python3 dev.py bench {chart.bench}` on {_baseline()[chart.bench]['recorded']}."]
    return "\n".join([*parts, ""])


def draw_chart(chart: ChartOfBars) -> str:
    """Return one chart of the page as SVG."""
    groups = tuple(BarGroup(label, tuple(_figure(chart.bench, key) for key in keys)) for label, keys in chart.groups)
    return draw_bars(chart.title, chart.unit, chart.series, groups)


@cache
def _baseline() -> dict:
    return json.loads(BASELINE.read_text(encoding="utf-8"))


def _figure(bench: str, key: str) -> float:
    return float(_baseline()[bench]["figures"][key]["value"])


def _show(bench: str, key: str) -> str:
    value = Decimal(str(_figure(bench, key)))
    places = 0 if value >= 100 or value == int(value) else 1 if value >= 10 else 2
    return f"{value.quantize(Decimal(1).scaleb(-places), ROUND_HALF_UP):,}"
