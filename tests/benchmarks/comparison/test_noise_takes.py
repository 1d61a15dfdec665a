"""Test the marker fits on each take: measured parts, rows of the published tables, and medians of the benchmark."""

from __future__ import annotations

import json
from collections import Counter

import pytest

from supply.published_page import BASELINE, LEAST_TAKES, rows
from supply.published_page import PUBLISHED as PUBLISHED_ROWS
from tests.benchmarks import bench_noise_aware
from tests.benchmarks.comparison.landmark_takes import NOISES
from tests.benchmarks.comparison.noise_takes import OURS, RESULTS, SEEDS, TAKES, parts

NAMES = {part.name for part in parts()}


def test_every_fit_is_measured_once_per_take_and_seed_and_inference_has_one_seed():
    found = Counter((part.name, part.take, part.seed) for part in parts())
    assert set(found.values()) == {1}
    for name in NAMES:
        seeds = SEEDS[:1] if name.startswith("inference") else SEEDS
        assert {(take, seed) for other, take, seed in found if other == name} == {(t, s) for t in TAKES for s in seeds}


def test_published_rows_name_methods_that_are_measured_and_rest_on_enough_takes():
    named = [
        row
        for row in json.loads(PUBLISHED_ROWS.read_text(encoding="utf-8"))["rows"]
        if row.get("bench") == "noise_aware"
    ]
    assert {name for row in named for name in row["methods"]} <= NAMES
    judged = [row for row in rows() if row.bench == "noise_aware" and "joints" not in row.what and row.table != "4"]
    assert {row.num_takes for row in judged} == {LEAST_TAKES}


def test_published_methods_come_before_what_the_tables_do_not_publish():
    order = [part.method == OURS for part in parts() if part.seed == 0]
    assert order == sorted(order)


def test_the_baseline_has_the_figures_of_the_takes() -> None:
    kept, known = (json.loads(path.read_text(encoding="utf-8")) for path in (RESULTS, BASELINE))
    figures = {key: figure["value"] for key, figure in known["noise_aware"]["figures"].items() if key != "alpha"}
    assert {m.key: round(m.value, 5) for m in bench_noise_aware.metrics_of(kept["runs"])} == figures


def runs(noise_aware: float) -> dict:
    """Return figures with a different size for each take, and equal ratios between methods everywhere."""
    share = {"MoSh++": 2.0, "ours": 0.5, "noise-aware": noise_aware}
    found: dict = {}
    for part in parts():
        size = (1 + TAKES.index(part.take)) * share.get(part.method, 1.0)
        row = dict.fromkeys(bench_noise_aware.COLUMNS, size)
        found.setdefault(part.name, {}).setdefault(part.take, {})[str(part.seed)] = row
    return found


def test_figures_are_medians_over_takes_and_ratios_medians_of_ratios():
    found = {metric.key: metric.value for metric in bench_noise_aware.metrics_of(runs(1.0))}
    assert found["data_m_MoSh++_rmse_mm"] == pytest.approx(13.0)
    assert found["both_mj_noise-aware_mae_deg"] == pytest.approx(6.5)
    assert found["ratio_m"] == found["ours_to_published_worst"] == pytest.approx(0.5)
    assert found["direct_markers_rmse_mm"] == pytest.approx(6.5)
    assert bench_noise_aware.metrics_of(runs(0.25))[-1].value == pytest.approx(2.0)
    text = bench_noise_aware.as_text(runs(1.0), {0.5: 12.0})
    assert all(f"| {noise}, markers, MoSh++ | 13.00 |" in text for noise in NOISES)
    assert "2.000, 2.000 to 2.000" in text
