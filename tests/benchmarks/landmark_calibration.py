"""Temperature of the point network's label scores, and the frequency of "no marker", on recorded takes.

``python -m tests.benchmarks.landmark_calibration`` prints the cross-entropy of single frames by temperature and by the
amount subtracted from the ghosts' score. The takes are UI-PRMD's subjects 1 to 6 and nimble's Subject4, unchanged and
with 5 missing markers and 3 ghosts. ``bench landmarks_net`` labels none of them. The shipped weights are already
calibrated, so the minimum is near 1 and 0.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solver_backend.io.markers.read import read_markers
from solver_backend.labelling.outputs import GHOST
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.types import MarkerCloud
from tests.benchmarks.marker_takes.takes import folder, part, ui_prmd
from tests.support.unlabelled_takes import stripped

CLIPS = ("m02_s01_e03", "m04_s02_e04", "m05_s03_e02", "m07_s04_e05", "m09_s05_e02", "m10_s06_e03")
NIMBLE = ("DJ1", "STS1", "squats1", "static1")
TEMPERATURES = (0.75, 1.0, 1.25, 1.5, 1.75)
GHOST_LOGITS = (-1.0, 0.0, 1.0, 2.0)
_EVERY, _LEAST = 8, -8.0
"""Frame step, and smallest log probability of a single reading, as in the labelling."""


def takes() -> Iterator[MarkerCloud]:
    """Yield the takes that exist."""
    paths = [folder() / "ui_prmd" / f"{clip}.npz" for clip in CLIPS]
    yield from (ui_prmd(path) for path in paths if path.is_file())
    trials = folder() / "nimble" / "Subject4" / "MarkerData"
    yield from (part(read_markers(trials / f"{name}.trc").cloud, slice(0, 800)) for name in NIMBLE)


def readings(network: PointNetwork, cloud: MarkerCloud, **spoiled: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 54) label scores of the points of single frames, and their (n,) true labels."""
    bare = stripped(cloud, 1, **spoiled)
    points, truth = bare.cloud.positions[::_EVERY], bare.truth[::_EVERY]
    seen = np.isfinite(points).all(-1)
    scores = [network(np.where(seen[[i], :, None], points[[i]], 0.0), seen[[i]]).scores[0] for i in range(len(points))]
    return np.stack(scores).astype(float)[seen], truth[seen]


def cross_entropy(scores: np.ndarray, truth: np.ndarray, temperature: float, ghost_logit: float) -> float:
    """Return the mean cross-entropy in nats of scores with this calibration."""
    z = scores / temperature
    z[:, GHOST] -= ghost_logit
    z -= z.max(axis=1, keepdims=True)
    found = np.take_along_axis(z, truth[:, None], axis=1)[:, 0] - np.log(np.exp(z).sum(axis=1))
    return float(-np.maximum(found, _LEAST).mean())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", nargs="?", type=Path, help="weights of a point network; those that ship")
    network = load_network(parser.parse_args().weights)
    read = [readings(network, cloud, **how) for cloud in takes() for how in ({}, {"missing": 5, "ghosts": 3})]
    rows = [" ".join(["T \\ ghost", *(f"{ghost:7g}" for ghost in GHOST_LOGITS)])]
    for temperature in TEMPERATURES:
        row = [np.mean([cross_entropy(s, t, temperature, ghost) for s, t in read]) for ghost in GHOST_LOGITS]
        rows.append(" ".join([f"{temperature:9g}", *(f"{value:7.3f}" for value in row)]))
    sys.stdout.write("\n".join([*rows, ""]))


if __name__ == "__main__":
    main()
