"""Errors of filled gaps relative to the recording: 15 % of the samples are hidden in bursts of half a second."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from research.baselines.rigid_filling import fill_rigidly
from solver_backend.fitters import SolveSettings, solve
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import Capture, MarkerCloud, Motion
from tests.benchmarks.metric import Metric

SHARE, BURST_S = 0.15, 0.5
BOUNDS = {"mean": 0.55, "p95": 0.4}
"""Upper limits of our error relative to the common filling."""


@dataclass(frozen=True)
class HeldOut:
    """Distances of hidden markers from their fillings in millimetres."""

    rigid: np.ndarray
    """Filling by a rigid cluster of neighbours."""
    body: np.ndarray
    """Filling by the solved body."""
    ours: np.ndarray
    """Filling by the body, joined to both ends of the gap."""
    better: np.ndarray
    """The rigid or our filling, whichever has the smaller mean error in a gap. This is unknown in practice."""

    def figures(self, which: str) -> tuple[float, float, float]:
        """Return mean, median and 95th percentile."""
        error = getattr(self, which)
        return float(error.mean()), float(np.median(error)), float(np.quantile(error, 0.95))


def hidden(cloud: MarkerCloud, seed: int) -> np.ndarray:
    """Return an (F, M) mask of measured samples that are hidden."""
    rng, seen = np.random.default_rng(seed), np.isfinite(cloud.positions).all(-1)
    length, found = max(2, round(BURST_S * cloud.fps)), np.zeros_like(seen)
    while (found & seen).sum() < SHARE * seen.sum():
        marker, start = rng.integers(seen.shape[1]), rng.integers(-length // 2, len(seen) - length // 2)
        found[max(start, 0) : start + length, marker] = True
    return found & seen


def held_out(cloud: MarkerCloud, seed: int = 0, settings: SolveSettings = SolveSettings()) -> HeldOut:
    """Return the filling errors of one take, over the markers that the solve uses."""
    hide = hidden(cloud, seed)
    shown = np.where(hide[..., None], np.nan, cloud.positions)
    motion = solved_hidden(cloud, hide, settings)
    assert motion.marker_labels is not None and motion.cleaned_markers is not None and motion.markers is not None
    labels = cloud.labels or ()
    columns = [labels.index(label) for label in motion.marker_labels]
    truth, judged = cloud.positions[:, columns], hide[:, columns]
    fillings = fill_rigidly(shown)[:, columns], motion.markers, motion.cleaned_markers
    rigid, body, ours = (1000 * np.linalg.norm(points - truth, axis=-1) for points in fillings)
    return HeldOut(rigid[judged], body[judged], ours[judged], better_by_gap(rigid, ours, judged))


def solved_hidden(cloud: MarkerCloud, hide: np.ndarray, settings: SolveSettings = SolveSettings()) -> Motion:
    """Return the solve of a take without the (F, M) hidden samples."""
    shown = np.where(hide[..., None], np.nan, cloud.positions)
    return solve(Capture("take", markers=replace(cloud, positions=shown, residual=None)), settings).motion


def better_by_gap(one: np.ndarray, other: np.ndarray, judged: np.ndarray) -> np.ndarray:
    """Return the (F, M) distances of the evaluated samples, for each gap from the filling with the smaller mean."""
    found = []
    for m in range(judged.shape[1]):
        for first, last in true_runs(judged[:, m]):
            part = slice(first, last + 1)
            found.append(min(one[part, m], other[part, m], key=lambda gap: float(gap.mean())))
    return np.concatenate(found)


def pooled(found: list[HeldOut]) -> HeldOut:
    """Concatenate the distances of several takes."""
    names = [field.name for field in fields(HeldOut)]
    return HeldOut(*(np.concatenate([getattr(item, name) for item in found]) for name in names))


def report(found: dict[str, HeldOut]) -> tuple[str, list[Metric]]:
    """Return the table as text, and our errors relative to the common filling's."""
    lines = [f"{'hidden markers, mm':<22}{'filling':<12}{'mean':>8}{'median':>8}{'95 %':>8}{'of rigid':>14}"]
    metrics: list[Metric] = []
    for layout, item in found.items():
        base = item.figures("rigid")
        for which, name in (("rigid", "rigid"), ("body", "body alone"), ("ours", "ours"), ("better", "better")):
            mean, median, far = item.figures(which)
            shares = f"{mean / base[0]:.2f} / {far / base[2]:.2f}"
            lines.append(f"{layout:<22}{name:<12}{mean:8.2f}{median:8.2f}{far:8.2f}{shares:>14}")
        key = layout.replace(" ", "_").lower()
        mean, _, far = item.figures("ours")
        metrics += [
            Metric(f"{key}_mean_share", mean / base[0], "", rel_tol=0.1),
            Metric(f"{key}_p95_share", far / base[2], "", rel_tol=0.15),
        ]
    return "\n".join(lines), metrics
