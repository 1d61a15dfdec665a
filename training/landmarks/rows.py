"""Rows of the published tables. A row is a network with its width, balance and clouds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from solver_backend.body.body import Body
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.outputs import write_text
from solver_backend.labelling.outputs import LANDMARKS, MARKERS
from training.landmarks.cloud_stream import Clouds, CloudStream, Variety
from training.landmarks.loop import LandmarkTraining, train_landmarks
from training.landmarks.models import (
    BLOCKS,
    SIZE,
    DemocapLike,
    Divergence,
    FromCoordinates,
    LandmarkModel,
    Loss,
    Ours,
    PointNetWidths,
    Published,
)
from training.landmarks.poses import Balance, PoseTable, drawer

SETS = ("ordinary", "tail", "floor")
_ARM = ("SHO", "UPA", "ELB", "ELM", "FRM", "WRA", "WRB", "FIN", "shoulder", "elbow", "wrist", "hand")
_LEG = ("THI", "KNE", "KNM", "SHN", "ANK", "ANM", "HEE", "MT1", "MT5", "TOE", "hip", "knee", "ankle", "foot")
LIMBS = {
    "all": tuple(range(len(LANDMARKS))),
    "arms": tuple(i for i, name in enumerate(LANDMARKS) if name.endswith(_ARM)),
    "legs": tuple(i for i, name in enumerate(LANDMARKS) if name.endswith(_LEG)),
}
PART = 250
"""Number of poses in each draw. Chosen by hand."""


def evaluation_clouds(
    stream: CloudStream, poses: Mapping[str, torch.Tensor], seed: int = 1234
) -> dict[str, list[Clouds]]:
    """Return the clouds for each set of poses. Equal seeds give equal clouds."""
    torch.manual_seed(seed)
    return {name: [stream.draw(part) for part in poses[name].split(PART)] for name in poses}


@torch.no_grad()
def evaluate(model: LandmarkModel, clouds: list[Clouds]) -> dict[str, float]:
    """Return RMSE and MPJPE in mm, PCK in percent, and ``rmse3`` = (1 - PCK3) RMSE.

    RMSE is the mean over samples of the root mean square distance over landmarks. For the product's own network, the
    percentage of correct labels is added.
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
    right = points = 0
    for c in clouds:
        estimated = model.net(c.points, c.seen).scores.argmax(-1)
        right += int(((estimated == c.labels) & c.seen).sum())
        points += int(c.seen.sum())
    return {"labels_right": 100.0 * right / max(points, 1)}


FIXED = Variety(layouts=False, pose_noise=0.0, exchanged=0.0, thinned=0.0, parts=0.0, tilted=0.0)
"""Clouds of all 53 markers, with the thesis' corruptions, sizes, headings, misplaced markers and props."""
THESIS = replace(FIXED, wobble_rad=0.0, headings=False, sizes=0.0, strayed=False, thesis=True)
"""The clouds in the thesis: all 53 markers, with its augmentations and corruptions only (4.20 to 4.27)."""
CLOUDS = {"thesis": THESIS, "fixed": FIXED}
"""Clouds of 53 markers for comparing all rows, by the names used in figures and tables."""
UNBALANCED = Balance()
ORTHO = Balance(relevance="σ(D)", sampler="squad")
"""The best balance in the thesis: poses are weighted by relevance, and poses are added."""
FADING = replace(ORTHO, blended=0.5, fades=True)  # Ours: twice as many added poses, faded out halfway.


HALVED = 2 ** (BLOCKS - 1)  # Factor by which a UNet reduces the size of maps.
OURS_WIDTH = 128  # Width of the shipped network.


@dataclass(frozen=True)
class Row:
    """One row of the tables: a network with its settings, to train and evaluate."""

    network: str  # ``ours``, ``published``, ``democap`` or ``coordinates``.
    width: int
    balance: Balance = UNBALANCED
    loss: Loss = "welsch"
    divergence: Divergence = "kullback-leibler"
    variety: Variety = FIXED
    resolution: int = SIZE  # Width and height of a drawn map in pixels.
    name: str = ""  # Name in the tables.

    def model(self) -> LandmarkModel:
        """Return the row's untrained network."""
        if self.network == "ours":
            return Ours(PointNetWidths(self.width))
        if self.network == "democap":
            return DemocapLike(self.width, loss=self.loss, size=self.resolution)
        if self.network == "coordinates":
            return FromCoordinates(self.width)
        return Published(self.width, loss=self.loss, size=self.resolution, divergence=self.divergence)


def named_rows(width: int, ours_width: int = 0, resolution: int = SIZE) -> dict[str, Row]:
    """Return all rows of the published tables, by name.

    Settings are the UNets' width and resolution (32 and 160 in the paper) and the width of the product's own network.

    Raises:
        JobInvalid: maps of that size cannot be halved four times.
    """
    if resolution < 1 or resolution % HALVED:
        raise JobInvalid(f"Maps are a multiple of {HALVED} pixels wide, not {resolution}.", hint="--resolution 160.")
    base = Row("published", width, resolution=resolution)
    rows = {"base": base, "bmse": replace(base, loss="bmse"), "ortho": replace(base, balance=ORTHO)}
    rows["ortho fading"] = replace(base, balance=FADING)
    rows["base js"] = replace(base, divergence="jensen-shannon")
    rows |= {name: replace(base, balance=Balance(sampler=name)) for name in (
        "random", "lerp", "slerp", "squad", "bezier", "bspline",
    )}  # fmt: skip
    rows |= {kind: replace(base, balance=Balance(relevance=kind)) for kind in ("e(R)", "σ(R)", "e(D)", "σ(D)")}
    rows |= {f"{kind}+{name}": replace(base, balance=Balance(kind, name)) for kind, name in (
        ("e(D)", "squad"), ("e(R)", "slerp"),
    )}  # fmt: skip
    rows |= {f"{name} thesis": replace(rows[name], variety=THESIS) for name in ("base", "ortho", "e(R)+slerp", "squad")}
    democap, coordinates = replace(base, network="democap"), Row("coordinates", 256)
    rows |= {"democap": democap, "democap bmse": replace(democap, loss="bmse"), "coordinates": coordinates}
    rows["democap ortho"] = replace(democap, balance=ORTHO)
    ours = Row("ours", ours_width or OURS_WIDTH, Balance("σ(D)", "squad"), variety=Variety())
    rows |= {
        "ours": ours,
        "ours unbalanced": replace(ours, balance=Balance()),
        "ours one layout": replace(ours, variety=replace(Variety(), layouts=False)),
        "ours no ghosts": replace(ours, variety=replace(Variety(), ghosts=False)),
        "ours no noise": replace(ours, variety=replace(Variety(), noise=False)),
        "ours 53 fixed": replace(ours, variety=FIXED),
        "ours 53 thesis": replace(ours, variety=THESIS),
    }
    return {name: replace(row, name=name) for name, row in rows.items()}


def train_row(
    row: Row, table: PoseTable, body: Body, settings: LandmarkTraining, out: Path, start: Path | None = None
) -> dict[str, Any]:
    """Train a row, evaluate it on all sets of poses, and write ``weights.npz`` and ``figures.json`` to ``out``.

    The result is the weights with the smallest ``rmse3`` on a third of the ordinary poses, in clouds of the kind that
    the row is trained on. No figure uses these poses. With ``start``, training continues from another row's checkpoint
    with this row's settings.

    Raises:
        TrainingMismatch: ``out`` contains a checkpoint of another row or with other settings.
        NonFiniteData: poses of the table or the loss are NaN or infinite.
    """
    table.check_finite()
    out.mkdir(parents=True, exist_ok=True)
    device = settings.device
    kinds = {name: CloudStream(body, device, variety) for name, variety in CLOUDS.items()}
    if row.network == "ours":
        kinds["any"] = CloudStream(body, device)
    poses = evaluation_poses(table, device)
    evaluated = {f"{kind} {name}": c for kind, s in kinds.items() for name, c in evaluation_clouds(s, poses).items()}
    selection = f"{'thesis' if row.variety == THESIS else 'fixed'} selection"
    torch.manual_seed(settings.seed)
    model = row.model()
    draw = drawer(CloudStream(body, device, row.variety), table, settings.batch, row.balance)
    history: list[dict[str, Any]] = []

    def look(averaged: LandmarkModel, seconds: float, steps: int) -> None:
        at = {name: evaluate(averaged, clouds) for name, clouds in evaluated.items()}
        history.append({"seconds": seconds, "steps": steps, **at})
        chosen = min(history, key=lambda h: h[selection]["rmse3"])
        if chosen is history[-1]:
            arrays = {name: _half(value) for name, value in averaged.state_dict().items()}
            np.savez_compressed(out / "weights.npz", **arrays)
        record = {
            "row": asdict(row),
            "settings": asdict(settings),
            "parameters": sum(p.numel() for p in model.parameters()),
            "history": history,
            "chosen": chosen,
        }
        write_text(out / "figures.json", json.dumps(record, indent=1, ensure_ascii=False), overwrite=True)

    train_landmarks(model, draw, settings, out, look, start, asdict(row))
    return min(history, key=lambda h: h[selection]["rmse3"])


def evaluation_poses(table: PoseTable, device: str = "cpu") -> dict[str, torch.Tensor]:
    """Return the poses (N, 22, 3) of each evaluation set.

    The set ``selection`` is for choosing the weights. No figure uses it.
    """
    poses = {name: torch.as_tensor(table.poses(name), device=device) for name in SETS}
    return {"selection": poses["ordinary"][::3], **poses, "ordinary": poses["ordinary"][1::3]}


def _half(value: torch.Tensor) -> np.ndarray:
    array = value.detach().cpu().numpy()
    return array.astype(np.float16) if array.dtype == np.float32 else array
