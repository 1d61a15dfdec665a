"""Figures that stand in hand-written pages are those of the committed baseline, rounded as they are written."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BASELINE = json.loads((ROOT / "tests" / "benchmarks" / "baseline.json").read_text(encoding="utf-8"))
VIEWS, KEYS, TAKES = (2, 3, 4, 8), (2, 3, 4), ("exercises", "dance")
WRITTEN = {
    "README.md": {
        r"joint error for unseen people[^|]*\| ([\d.]+) mm \|": [("bundle", "mpjpe_mm")],
        r"exact detections \| ([\d.]+) mm": [("floor", "exact_points_mm")],
        r"rigid-body gap filling[^|]*\| ([\d.]+) to ([\d.]+) \|": [
            ("markers", "cmu_41_mean_share"), ("markers", "synthetic_42_mean_share")],
        r"confidence ellipsoids[^|]*\| ([\d.]+) %": [("markers", "held95")],
        r"bake 10,000 frames in Blender \| ([\d.]+) s": [("bake", "bake_cpu_s_10000_frames")],
        r"of eight views took ([\d.]+) MB": [("large_inputs", "8_views_18000_frames_peak_mb")],
        r"With three cameras, the simulated error is ([\d.]+) mm": [("bundle", "views_3_ours_mpjpe_mm")],
    },
    "docs/explanation/accuracy.md": {
        r"\| error " + r"\| ([\d.]+) mm " * 4: [("bundle", f"views_{n}_ours_mpjpe_mm") for n in VIEWS],
    } | {
        rf"\| {name} \| (\d+) Hz \| ([\d.]+) \|": [
            ("presets", f"{take}_balanced_{key}") for key in ("half_hz", "peak_share")]
        for take, name in zip(TAKES, ("exercises", "fast dance"), strict=True)
    },
    "docs/how-to/one-camera.md": {
        r"error is ([\d.]+) mm in the world and ([\d.]+) mm after": [
            ("one_camera_people", "world"), ("one_camera_people", "pa")],
    },
    "docs/questions.md": {r"about (\d+) ms of CPU": [("detector", "cpu_ms")]},
    "docs/tutorials/first-animation.md": {
        rf"\*\*{preset.title()}\*\*.*?" + r"\| ([\d.]+) mm, ([\d.]+) m/s², (\d+) Hz, ([\d.]+) s " * 2:
        [("presets", f"{take}_{preset}_{key}")
         for take in TAKES for key in ("mpjpe_mm", "accel_m_s2", "half_hz", "cpu_s")]
        for preset in ("fast", "balanced")
    },
    "docs/how-to/edit-a-take.md": {
        rf"\| {n} \| (\d+) mm \| (\d+) mm": [("few_keys", f"{take}_{n}_keys_largest_mm") for take in TAKES]
        for n in KEYS
    },
    "docs/how-to/calibrate-cameras.md": {
        rf"\| {name}.*? \| (\d+) mm \| ([\d.]+)°": [
            ("calibration", f"person{n}_centres_mm"), ("calibration", f"person{n}_directions_deg")]
        for n, name in enumerate(("exercises", "dance", "walk"))
    },
    "docs/how-to/choose-a-detector.md": {
        r"([\d.]+) mm instead of ([\d.]+) mm for such": [
            ("detector_noise", "rough_by_its_map"), ("detector_noise", "rough_as_it_is")],
    },
    "docs/how-to/batch-and-cluster.md": {
        rf"\| 8 views, {n:,} frames \| (\d+) s \| ([\d,]+) MB": [
            ("large_inputs", f"8_views_{n}_frames_{key}") for key in ("cpu_s", "peak_mb")]
        for n in (2250, 18000, 36000)
    } | {r"about (\d+) ms of CPU": [("detector", "cpu_ms")]},
    "docs/how-to/synchronise-cameras.md": {
        r"best \| median ([\d.]+) frames": [("sync", "median_error")],
        r"joints \| median ([\d.]+) frames": [("sync", "uncalibrated_median")],
    },
}  # fmt: skip
"""Page: pattern, and the benchmark and figure of each group."""


@pytest.mark.parametrize(
    ("page", "pattern", "figures"),
    [(page, pattern, figures) for page, rows in WRITTEN.items() for pattern, figures in rows.items()],
)
def test_a_written_figure_is_the_baselines(page: str, pattern: str, figures: list[tuple[str, str]]) -> None:
    found = re.search(pattern, (ROOT / page).read_text(encoding="utf-8"))
    assert found, f"{page} has no such figure"
    for text, (bench, key) in zip(found.groups(), figures, strict=True):
        value = BASELINE[bench]["figures"][key]["value"]
        places = len(text.partition(".")[2])
        assert abs(float(text.replace(",", "")) - value) <= 0.5001 * 10**-places, (key, text, value)


FIGURE = re.compile(r"(?<![\w.])\d[\d.,]*\d? (?:mm|cm|m/s²|times|s|ms|%|px|°)(?!\w)")
DEFINITIONS = (
    "inside the 95 %", "green up to 10 mm, orange up to 25 mm", "spheres of 14 mm",
)  # fmt: skip
"""Figures that nobody measured: definitions, sizes of equipment, and examples of messages."""
TOLD = ["README.md", *(page.relative_to(ROOT).as_posix() for page in sorted((ROOT / "docs/tutorials").glob("*.md")))]


@pytest.mark.parametrize("page", TOLD)
def test_every_figure_of_a_page_is_the_baselines(page: str) -> None:
    """The results' page is made from the baseline as a whole, see ``tests/supply``."""
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    for known in (*WRITTEN.get(page, ()), *map(re.escape, DEFINITIONS)):
        text = re.sub(known, "", text)
    assert FIGURE.findall(text) == [], "neither of the baseline nor a definition"
