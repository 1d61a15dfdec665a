"""How far landmarks are from the truth (thesis 4.28, 4.29), by poses and by limbs; and how many labels are right."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from solver_backend.labelling.outputs import LANDMARKS, MARKERS
from training.landmarks.cloud_stream import Clouds, CloudStream
from training.landmarks.models import LandmarkModel, Ours

SETS = ("ordinary", "tail", "floor")
_ARM = ("SHO", "UPA", "ELB", "ELM", "FRM", "WRA", "WRB", "FIN", "shoulder", "elbow", "wrist", "hand")
_LEG = ("THI", "KNE", "KNM", "SHN", "ANK", "ANM", "HEE", "MT1", "MT5", "TOE", "hip", "knee", "ankle", "foot")
LIMBS = {
    "all": tuple(range(len(LANDMARKS))),
    "arms": tuple(i for i, name in enumerate(LANDMARKS) if name.endswith(_ARM)),
    "legs": tuple(i for i, name in enumerate(LANDMARKS) if name.endswith(_LEG)),
}
PART = 250
"""Poses of one draw; chosen by hand."""


def evaluation_clouds(
    stream: CloudStream, poses: Mapping[str, torch.Tensor], seed: int = 1234
) -> dict[str, list[Clouds]]:
    """Return the clouds of every set of poses, the same for the same seed."""
    torch.manual_seed(seed)
    return {name: [stream.draw(part) for part in poses[name].split(PART)] for name in poses}


@torch.no_grad()
def evaluate(model: LandmarkModel, clouds: list[Clouds]) -> dict[str, float]:
    """Return RMSE and MPJPE in mm, PCK in percent, ``rmse3`` = (1 - PCK3) RMSE; of ours labels too, in percent.

    RMSE is the mean over samples of the root of the mean squared distance over landmarks.
    """
    model.eval()
    distance = torch.cat([(model.positions(c) - c.targets[:, list(model.columns)]).norm(dim=-1) for c in clouds]).cpu()
    figures = {
        "rmse_mm": 1e3 * float(distance.square().mean(1).sqrt().mean()),
        "mpjpe_mm": 1e3 * float(distance[:, len(MARKERS) :].mean()),
        "marker_mm": 1e3 * float(distance[:, : len(MARKERS)].mean()),
    }
    at = {column: i for i, column in enumerate(model.columns)}
    for limb, columns in LIMBS.items():
        mine = distance[:, [at[c] for c in columns if c in at]]
        for limit in (10, 30, 70):
            figures[f"pck{limit // 10}_{limb}"] = 100.0 * float((mine < 1e-3 * limit).float().mean())
    figures["rmse3"] = (1.0 - figures["pck3_all"] / 100.0) * figures["rmse_mm"]
    if isinstance(model, Ours):
        figures |= _labels(model, clouds)
    model.train()
    return figures


def _labels(model: Ours, clouds: list[Clouds]) -> dict[str, float]:
    """Return the share of right labels by point, and of markers with a point labelled as another, in percent."""
    right = points = 0
    for c in clouds:
        estimated = model.net(c.points, c.seen).scores.argmax(-1)
        right += int(((estimated == c.labels) & c.seen).sum())
        points += int(c.seen.sum())
    return {"labels_right": 100.0 * right / max(points, 1)}
