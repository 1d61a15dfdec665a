"""Thesis tables 4.5 and 6.5: pose autoencoders as samplers, as reconstructions and as priors of a fit.

1,052 poses of each prior are compared with 1,052 of CMU's held-out subjects. FID and DIV use VPoser's codes in 526
pairs, as in the thesis, which favours VPoser, and joint positions (dm), which favour no prior. The held-out poses are
reconstructed. 150 of them are fitted to 53 exact markers with known shape, root and place, with codes pulled towards
zero. Samples are medians of three seeds. Weights are medians of the shipped ones and of other seeds on the same corpus
under build/autoencoder_rows (`python -m tests.benchmarks.pose_priors.train_autoencoders`). ``spread`` is two standard
errors of the ratio of a row's median to VPoser's. Needs the validation motions (MOCAP_SHARED_DATA). The table is
written to build/bench_autoencoders.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from research.priors import load_prior, stored_priors, weight_file
from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.metrics import angle_mae_deg, pck_percent
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.gaussian_vae import LATENT_DIM, GaussianVAE
from solver_backend.priors.weights import read_weights
from tests.benchmarks.comparison.validation_takes import clip_paths, read_take
from tests.benchmarks.metric import Metric
from tests.benchmarks.pose_priors import prior_tables as tables
from tests.benchmarks.pose_priors.latent_chain import LatentChain
from tests.benchmarks.pose_priors.train_autoencoders import ROOT, trained
from tests.benchmarks.seed_spread import ratio_spread
from training.data.points import rotation_points

OUT = Path(__file__).resolve().parents[2] / "build" / "bench_autoencoders"
SAMPLES, FITTED = 1052, 150
"""Number of poses that are sampled, as in the thesis, and of poses that are fitted."""
SEEDS = (0, 1, 2)
PULL = 1e-5
"""λ of the fit in m². A code one standard deviation long has the same weight as markers 3 mm off."""
FIT_ITERATIONS = 60


BASE = "vposer"  # Row for comparison with the others.
KEPT = {
    "FID codes": ("fid_codes", "lower"), "DIV codes": ("div_codes", "higher"),
    "FID / DIV codes": ("indicator", "lower"), "FID": ("fid", "lower"),
    "DIV": ("div", "higher"), "MPJPE mm": ("mpjpe_mm", "lower"), "PCK3 %": ("pck3_percent", "higher"),
    "PCK7 %": ("pck7_percent", "higher"), "fit MAE °": ("fit_mae_deg", "lower"),
    "fit PCK1 %": ("fit_pck1_percent", "higher"), "fit PCK3 %": ("fit_pck3_percent", "higher"),
    "fit PCK7 %": ("fit_pck7_percent", "higher"),
}  # fmt: skip
"""Columns of the thesis tables: key of the figure, and whether lower or higher is better."""


def run() -> list[Metric]:
    """Sample, reconstruct, fit, and write the table."""
    poses = held_out_poses()
    encoder = load_prior("vposer")
    codes, real = np.asarray(encoder.encode(poses)), tables.features(poses)
    found: dict[str, list[dict[str, float]]] = defaultdict(list)
    for name, priors in autoencoders().items():
        for prior in priors:
            drawn = [np.asarray(prior.sample(SAMPLES, seed)) for seed in SEEDS]
            sampled = [
                tables.code_synthesis(d, codes, encoder, seed) | tables.synthesis(d, real, seed)
                for seed, d in zip(SEEDS, drawn, strict=True)
            ]
            row = {column: float(np.median([sample[column] for sample in sampled])) for column in sampled[0]}
            row |= tables.reconstruction(prior, poses)
            found[name].append(row | (marker_fit(prior, poses[:FITTED]) if isinstance(prior, GaussianVAE) else {}))
    rows = {
        name: {column: float(np.median([row[column] for row in trainings])) for column in trainings[0]}
        for name, trainings in found.items()
    }
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "trainings.json").write_text(json.dumps(found, ensure_ascii=False, indent=1), encoding="utf-8")
    (OUT / "tables.md").write_text(tables.text_table("Thesis tables 4.5 and 6.5", rows), encoding="utf-8")
    return [*metrics_of(rows), *spreads(found), Metric("seeds", min(map(len, found.values())), "", "higher")]


def autoencoders() -> dict[str, list[AutoencodingPrior]]:
    """Return the trainings of every autoencoder: the shipped weights, then other seeds on the same corpus."""
    paths = {name: [weight_file(name)] for name in stored_priors() if name not in tables.POSE_ITSELF}
    for (name, _), path in trained(ROOT).items():
        paths.setdefault(name, []).append(path)
    return {name: [_autoencoder(name, path) for path in of_one_corpus(found)] for name, found in paths.items()}


def of_one_corpus(paths: Sequence[Path]) -> list[Path]:
    """Return the weights that were trained on the same corpus as the first ones."""
    corpora = [read_weights(path, None).metadata["data"]["sources"] for path in paths]
    return [path for path, corpus in zip(paths, corpora, strict=True) if corpus == corpora[0]]


def _autoencoder(name: str, path: Path) -> AutoencodingPrior:
    prior = load_prior(name, path)
    assert isinstance(prior, AutoencodingPrior)
    return prior


def held_out_poses() -> np.ndarray:
    """Return (1052, 21, 3, 3) poses of subjects on which no prior was trained."""
    rotations = np.concatenate([read_take(path).rotations[:, 1:22] for path in clip_paths()])
    return rotations[np.random.default_rng(0).choice(len(rotations), SAMPLES, replace=False)]


def marker_fit(prior: GaussianVAE, truth: np.ndarray) -> dict[str, float]:
    """Return the errors of (N, 21, 3, 3) poses fitted to their own markers (thesis table 4.5)."""
    body, names = load_body(), marker_layout("MANIFOLD_53")
    subject = Subject(body, marker_landmarks(body, names), np.zeros(10), np.zeros((len(names), 3)))
    root, transl, start = np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, LATENT_DIM))
    fitted = []
    for local in truth:
        markers = pose(subject, PosedFrames(root, local[None], transl)).points
        seen = np.ones(markers.shape[:2])
        fitted.append(LatentChain(subject, prior, root, transl, markers, seen, start, PULL, 0.0).solve(FIT_ITERATIONS))
    found = np.concatenate(fitted)
    points, true = rotation_points(found), rotation_points(truth)
    share = {f"fit PCK{cm} %": pck_percent(points, true, 0.01 * cm) for cm in (1, 3, 7)}
    return {"fit MAE °": angle_mae_deg(found, truth), **share}


def metrics_of(rows: tables.Table) -> list[Metric]:
    """Return the figures of the thesis tables by prior."""
    units = {"mm": "mm", "deg": "°", "percent": "%"}
    return [
        Metric(f"{name}_{key}", row[column], units.get(key.rpartition("_")[2], ""), direction)
        for name, row in rows.items()
        for column, (key, direction) in KEPT.items()
        if column in row
    ]


def spreads(found: Mapping[str, Sequence[dict[str, float]]]) -> list[Metric]:
    """Return the random spread of the ratio of each row's median to VPoser's, by column."""
    metrics = []
    for name in found:
        for column, (key, _) in KEPT.items():
            if name == BASE or column not in found[name][0] or column not in found[BASE][0]:
                continue
            values = {row: [training[column] for training in found[row]] for row in (name, BASE)}
            spread = ratio_spread(values, [(name, BASE)])
            metrics += [] if spread is None else [Metric(f"spread_{name}_{key}", spread, "")]
    return metrics
