"""Compare pose priors: samples, reconstruction by source, removed noise, frames between keys, with pictures.

FID, DIV and APD use positions of joints 1..23 about an unrotated pelvis on a skeleton of 1.70 m, in dm (FID in dm²),
for 1,000 samples and 4,000 distinct training poses. Reconstruction, noise and interpolation use validation subjects,
with joint errors for a fixed pelvis. Samples, noise and keys are medians of three seeds, and the weights are of one
seed. SPoser's widths are medians of three short trainings of 1,000 steps each. Pictures and tables are written to
build/priors (or --out). Needs the recordings next to the repository (or MOCAP_SHARED_DATA). The first run fits the
marker takes and trains nine small networks, which takes half an hour. Both are kept.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from research.priors import load_prior, stored_priors
from solver_backend.body.body import load_body
from solver_backend.exchange.errors import FileMissing
from solver_backend.fitters.pose_ndf.complete import interpolate_poses
from solver_backend.geometry.interpolation import sider2
from solver_backend.priors.base import PosePrior
from solver_backend.priors.pose_ndf import PoseNDF
from solver_backend.priors.sposer import SPoser
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.benchmarks.pose_priors import prior_tables as tables
from tests.benchmarks.pose_priors.prior_pictures import embedding, pose_grid
from tests.benchmarks.pose_priors.prior_widths import jacobian_times, width_table
from tests.support.recordings import ABSENT, recordings_folder
from training.data.corpus import Corpus, split_corpus
from training.data.sources.clips import load_clips
from training.data.sources.marker_takes import fitted_takes
from training.engine.accuracy import accuracy_by_source

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "build" / "priors"
_SEEDS = (0, 1, 2)
_SAMPLES, _REAL, _VALIDATION, _KEYS, _NOISED = 1000, 4000, 1000, 300, 150
_SPACING = 6
"""Frames between keys: 0.2 s."""


@dataclass(frozen=True)
class _Poses:
    """Poses on which the priors are measured."""

    training: Corpus
    validation: Corpus
    real: np.ndarray
    """Features of distinct training poses."""
    truth: np.ndarray
    """Distinct validation poses."""


def run(out: Path = OUT) -> list[Metric]:
    """Print the tables, write them and the pictures, and return SPoser's figures."""
    poses = _read(recordings_folder(), out)
    priors = [load_prior(name) for name in stored_priors()]
    parts = [
        _marker_residuals(recordings_folder(), out),
        tables.text_table("Synthesis and reconstruction (thesis tables 4.5 and 6.5)", _main_table(priors, poses)),
        _by_source(priors, poses.validation),
        tables.text_table("Noise of 20 joints: error after over before", _denoising(priors, poses)),
        tables.text_table("Frame between keys 0.2 s apart, MPJPE mm", _interpolation(priors, poses)),
        tables.text_table("Width of SPoser's decoder", _widths(priors, poses, out)),
    ]
    text = "\n".join(parts)
    sys.stdout.write(text)
    out.mkdir(parents=True, exist_ok=True)
    (out / "tables.md").write_text(text, encoding="utf-8")
    _pictures(priors, poses, out)
    return _metrics(priors, poses)


def _read(data: Path, out: Path) -> _Poses:
    try:
        training, validation = split_corpus(load_clips(data, cache=out / "fitted_takes"))
    except FileMissing as error:
        raise BenchmarkSkipped("The recordings are not here.", hint=ABSENT) from error
    real = tables.features(_some(training, _REAL))
    return _Poses(training, validation, real, _some(validation, _VALIDATION))


def _some(corpus: Corpus, count: int) -> np.ndarray:
    distinct = np.unique(corpus.distinct)
    chosen = np.random.default_rng(0).choice(distinct, min(count, len(distinct)), replace=False)
    return corpus.rotations[chosen].astype(np.float64)


def _medians(measure: Callable[[int], dict[str, float]]) -> dict[str, float]:
    runs = [measure(seed) for seed in _SEEDS]
    return {name: float(np.median([r[name] for r in runs])) for name in runs[0]}


def _main_table(priors: list[PosePrior], poses: _Poses) -> tables.Table:
    seen = _some(poses.training, _SAMPLES)
    rows = {
        "real, training": tables.synthesis(seen, poses.real, 0),
        "real, validation": tables.synthesis(poses.truth, poses.real, 0),
    }
    for prior in priors:
        sampled = _medians(
            lambda seed, p=prior: tables.synthesis(np.asarray(p.sample(_SAMPLES, seed)), poses.real, seed)
        )
        rows[prior.name] = sampled | tables.reconstruction(prior, poses.truth)
    return rows


def _by_source(priors: list[PosePrior], validation: Corpus) -> str:
    text = ""
    for prior in priors:
        if prior.name not in tables.POSE_ITSELF:
            rows = accuracy_by_source(validation, lambda R, p=prior: p.decode(p.encode(R)))
            text += tables.text_table(f"Reconstruction by source: {prior.name}", rows) + "\n"
    return text


def _denoising(priors: list[PosePrior], poses: _Poses) -> tables.Table:
    truth = poses.truth[:_NOISED]
    return {p.name: _medians(lambda seed, p=p: tables.denoising(p, truth, seed)) for p in priors}


def _interpolation(priors: list[PosePrior], poses: _Poses) -> tables.Table:
    keys = [tables.draw_keys(poses.validation, _SPACING, _KEYS, seed) for seed in _SEEDS]
    rows = {"no prior (quaternions)": _medians(lambda seed: tables.interpolation(None, keys[seed]))}
    for prior in priors:
        rows[prior.name] = _medians(lambda seed, p=prior: tables.interpolation(p, keys[seed]))
    return rows


def _widths(priors: list[PosePrior], poses: _Poses, out: Path) -> tables.Table:
    shipped = next(p for p in priors if isinstance(p, SPoser))
    rows = width_table(poses.training, poses.validation, poses.truth, out / "widths")
    found = tables.reconstruction(shipped, poses.truth) | jacobian_times(shipped)
    name = f"H = {shipped.widths[1][1]}, as it ships"
    return rows | {name: {column: found[column] for column in rows["H = 128"] if column in found}}


def _marker_residuals(data: Path, out: Path) -> str:
    takes = fitted_takes(data / "markers" / "ui_prmd", out / "fitted_takes")
    rows: tables.Table = {}
    for subject in sorted({take.subject for take in takes}):
        residual = np.concatenate([take.residual_mm for take in takes if take.subject == subject])
        rows[f"ui_prmd {subject}"] = {
            "frames": float(len(residual)), "mean mm": float(residual.mean()),
            "median mm": float(np.median(residual)), "95 % mm": float(np.percentile(residual, 95)),
        }  # fmt: skip
    return tables.text_table("Marker fit: mean distance of a frame's markers", rows)


def _pictures(priors: list[PosePrior], poses: _Poses, out: Path) -> None:
    body = load_body()
    rows = {"real": poses.truth[:8]} | {p.name: np.asarray(p.sample(8, 0)) for p in priors}
    pose_grid(out / "samples.png", body, rows)
    keys = tables.draw_keys(poses.validation, 15, 1, 1)
    strips = {}
    for prior in priors:
        if isinstance(prior, SPoser):
            a, b, c = (prior.encode(keys.poses[:, k]) for k in range(3))
            path = [sider2(a, b, c, t) for t in np.linspace(0.0, 1.0, 9)]
            strips["SIDER2, " + prior.name] = prior.decode(np.concatenate(path))
        if isinstance(prior, PoseNDF):
            ends = keys.poses[:, 0], keys.poses[:, 2]
            strips["manifold, " + prior.name] = np.concatenate(
                [ends[0], interpolate_poses(prior, *ends, 7)[0], ends[1]]
            )
        if prior.name not in tables.POSE_ITSELF:
            first, last = (prior.encode(keys.poses[:, k]) for k in (0, 2))
            strips["LERP, " + prior.name] = prior.decode(
                np.concatenate([(1 - t) * first + t * last for t in np.linspace(0.0, 1.0, 9)])
            )
    pose_grid(out / "interpolation.png", body, strips)
    clouds = {p.name: tables.features(np.asarray(p.sample(2000, 0))) for p in priors}
    embedding(out / "embedding.png", poses.real[:4000], clouds)


def _metrics(priors: list[PosePrior], poses: _Poses) -> list[Metric]:
    prior = next(p for p in priors if isinstance(p, SPoser))
    found = tables.reconstruction(prior, poses.truth)
    times = jacobian_times(prior)
    return [
        Metric("sposer_mpjpe_mm", found["MPJPE mm"], "mm"),
        Metric("sposer_worst5_mpjpe_mm", found["worst 5 % mm"], "mm"),
        Metric("sposer_pck3_percent", found["PCK3 %"], "%", "higher", rel_tol=0.01),
        Metric("sposer_jacobian_2000_numpy_s", times["NumPy s"], "s", rel_tol=0.5),
        Metric("sposer_jacobian_2000_torch_s", times["torch s"], "s", rel_tol=0.5),
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="bench_priors", description="Tables and pictures of all priors.")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the tables and pictures")
    run(parser.parse_args().out)
