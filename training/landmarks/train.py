"""Train the landmark network, from recordings or a table of poses, to the shipped weights."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.labelling.point_network import NAME
from solver_backend.labelling.tracklets import NAME as TABLE_NAME
from solver_backend.priors.gaussian_vae import VaeName, load_vae
from solver_backend.priors.weights import PriorWeights, write_weights
from training.data.corpus import HELD_OUT
from training.data.sources.clips import load_clips, load_far_clips
from training.engine.loop import check_device
from training.engine.publish import Finished
from training.landmarks.distance_table import write_distance_table
from training.landmarks.loop import LandmarkTraining
from training.landmarks.models import SIZE
from training.landmarks.poses import HELD_TAKES, PoseTable, pose_table
from training.landmarks.rows import named_rows, train_row

TEMPERATURE = 1.45
"""Divisor of the label scores. A network trained on endless clouds is overconfident on recorded clouds."""
GHOST_LOGIT = 1.5
"""Value subtracted from the score of "no marker", because training clouds have more points that are not markers.

Both values come from ``python -m tests.benchmarks.landmark_calibration``. On takes of UI-PRMD's subjects 1 to 6 and
nimble's Subject4, plain and corrupted, the cross-entropy is smallest near 1.5 and 2. The weaker correction is used,
because files with clusters have more points that are not markers than these takes."""
_LABELS = ("labels.weight", "labels.bias", "missing")


def calibrated(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Calibrate label scores: divide by ``TEMPERATURE``, and lower the ghost's score (Guo et al. 2017, eq. 9).

    Args:
        arrays: weights of ``PointNet`` by name. The last label is the ghost.
    """
    out = {name: array.astype(np.float32) / TEMPERATURE if name in _LABELS else array for name, array in arrays.items()}
    out["labels.bias"][-1] -= GHOST_LOGIT
    return out


TABLES: dict[VaeName, str] = {"rvposer": "landmark_poses.npz", "vposer": "landmark_poses_vposer.npz"}
"""Pose tables, by the autoencoder that measures rarity and blends poses. Table 4.6 in the thesis compares both."""
DISTANCES = "distances"  # Name of the row without a network: the table of marker distances.
PUBLISHED_WIDTH = 32  # Channels in the first block of the published rows. Chosen by hand.


def train_landmark_rows(
    data: Path, out: Path, settings: LandmarkTraining, *, row: str = "ours", width: int = 0, resolution: int = 0,
    work: Path | None = None, start: Path | None = None, balanced_by: VaeName = "rvposer", progress: Progress = silent,
) -> Finished:  # fmt: skip
    """Train a row of the tables, or resume from its checkpoint.

    The product's own network is published as ``landmarks.npz`` together with a card.

    Args:
        data: folder with ``motion_cmu``, or a table of poses (``.npz``) of an earlier training.
        out: folder of the weights.
        settings: steps or seconds, batch size and so on.
        row: one of ``named_rows``, or ``DISTANCES`` for the table of marker distances.
        width: width of the network, or 0 for its default (128 for ours, 32 for the published one).
        resolution: map size of the published rows in pixels, or 0 for the paper's 160.
        work: folder of the checkpoint, by default ``out`` with the row's name.
        start: checkpoint of another row or seed to start from, if ``work`` has none.
        balanced_by: autoencoder that measures the rarity of recorded poses. A table already includes it.
        progress: called while recordings are loaded.

    Raises:
        JobInvalid: the row or device does not exist, or no UNet supports that map size.
        FileMissing: there are no recordings, none of the held-out subjects, or no such checkpoint.
        TrainingMismatch, FileDamaged: the checkpoint belongs to another row, or is damaged.
        NonFiniteData: poses or the loss are NaN or infinite.
    """
    check_device(settings.device)
    if row == DISTANCES:
        out.mkdir(parents=True, exist_ok=True)
        return Finished(write_distance_table(out / f"{TABLE_NAME}.npz", table_of(data, out, progress=progress)), {})
    ours = row.startswith("ours")
    rows = named_rows(
        width or PUBLISHED_WIDTH, ours_width=width if ours and width else 0, resolution=resolution or SIZE
    )
    if row not in rows:
        raise JobInvalid(f"There is no row {row!r} of the tables (known: {', '.join((*rows, DISTANCES))}).")
    out.mkdir(parents=True, exist_ok=True)
    table = table_of(data, out, balanced_by, progress)
    work = work or out / f"{NAME}_{row.replace(' ', '_')}_run"
    best = train_row(rows[row], table, load_body(), settings, work, start)
    figures = {f"{where} {key}": v for where in best if isinstance(best[where], dict) for key, v in best[where].items()}
    if row == "ours":
        with np.load(work / "weights.npz") as arrays:
            path = publish(dict(arrays), out, settings, figures, table)
    else:
        path = work / "weights.npz"
    absent = tuple(str(subject) for subject in table.arrays.get("absent", ()))
    return Finished(path, {key: value for key, value in figures.items() if "pck" not in key}, absent)


def table_of(data: Path, out: Path, balanced_by: VaeName = "rvposer", progress: Progress = silent) -> PoseTable:
    """Read the pose table in a file, or make it from a folder of recordings.

    A new table is stored in ``out``, because making it takes minutes.
    """
    kept = data if data.suffix == ".npz" else out / TABLES[balanced_by]
    if not kept.is_file():
        pose_table(load_clips(data, progress), load_far_clips(data), load_vae(balanced_by)).write(kept)
    return PoseTable.read(kept)


def publish(
    arrays: dict[str, np.ndarray],
    out: Path,
    settings: LandmarkTraining,
    figures: dict[str, float],
    table: PoseTable,
    note: str = "",
) -> Path:
    """Write ``landmarks.npz`` (half precision), and ``landmarks.md`` with a note. Return the path of the weights."""
    path = out / f"{NAME}.npz"
    named = {name.removeprefix("net."): np.asarray(array) for name, array in arrays.items()}
    halved = {name: array.astype(np.float16) for name, array in calibrated(named).items()}
    metadata: dict[str, Any] = {"settings": asdict(settings), "metrics": figures, "held_out": sorted(HELD_OUT)}
    digest = write_weights(path, PriorWeights(NAME, halved, metadata))
    write_text(path.with_suffix(".md"), _card(settings, figures, table, digest, _count(halved), note), overwrite=True)
    return path


def _count(arrays: dict[str, np.ndarray]) -> int:
    return sum(array.size for array in arrays.values())


def _card(
    settings: LandmarkTraining, figures: dict[str, float], table: PoseTable, digest: str, parameters: int, note: str
) -> str:
    rows = "\n".join(f"| {key} | {value:.4g} |" for key, value in figures.items())
    sizes = {name: len(table.arrays[name]) for name in ("training", "ordinary", "tail", "floor")}
    settings_rows = "\n".join(f"| `{key}` | {value} |" for key, value in asdict(settings).items())
    return f"""# Landmark network: marker labels of a point cloud

The network uses attention over the points of one frame ({parameters:,} parameters, half precision), with a bias by
distance in every attention. It assigns each point one of 53 markers or none. It also predicts a position with a
covariance for 53 markers and 24 joints. NumPy evaluates it (`solver_backend/labelling/point_network.py`), and
`train model landmarks` trains it.

## Data and licence

The training data are {sizes["training"]:,} distinct poses with the pelvis' rotation, from the priors' recordings: CMU
motion capture (mocap.cs.cmu.edu, NSF EIA-0196217) and hand-keyed animations by Quaternius and Mesh2Motion (CC0).
UI-PRMD is not used. Subjects {", ".join(sorted(HELD_OUT))} and the takes
{", ".join(HELD_TAKES)} are held out. The rarest 3 % are also held out and
used only as anchors of blended poses. Point clouds are generated during training with random shapes, marker placement
by each place's spread, mirroring, headings, tilts, sizes, layouts, subsets and parts of the body, occlusion, ghosts,
noise and props.

## Training

| setting | value |
|---|---|
{settings_rows}
{note}
After training, label scores are divided by {TEMPERATURE:g}, and the score of "no marker" is lowered by {GHOST_LOGIT:g}.
Recorded takes determine both (`tests/benchmarks/landmark_calibration.py`). The figures below are without this step.

## Validation

`thesis` has all 53 markers with the thesis' corruptions (4.20 to 4.27) alone. `fixed` adds sizes, headings, misplaced
markers, props and other ghosts. `any` has layouts, subsets and all variations of training. Poses are from held-out
subjects, in equal parts from {sizes["ordinary"]} ordinary, {sizes["tail"]} tail (crossed legs, crossed arms, kicks,
crouching) and {sizes["floor"]} floor poses. Positions are in mm, PCK and labels in percent.

| figure | value |
|---|---|
{rows}

Arrays' SHA-256: `{digest}`
"""
