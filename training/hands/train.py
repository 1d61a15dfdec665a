"""Train the hand prior: ``python -m training.hands --data FOLDER --out FOLDER``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.hand_skeleton import ANGLES, NUM_ANGLES, measure_angles
from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.npz import read_npz
from solver_backend.exchange.outputs import write_text
from solver_backend.geometry.rotations import matrix_from_quat
from solver_backend.priors.hand_prior import PRIOR
from solver_backend.priors.weights import PriorWeights, write_weights

_GODOT = ("Thumb", "Index", "Middle", "Ring", "Little")
_GODOT_JOINTS = (("Metacarpal", "Proximal", "Distal", "Tip"), ("Proximal", "Intermediate", "Distal", "Tip"))
"""Joints of the thumb and of the other fingers. In the add-on's body, fingers have no metacarpal joints."""
_KEYED = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")
_KEYED_TIP = 0.8
"""Length of a distal bone relative to the bone before it. The skeleton in the clips ends at the distal joint."""
_MARKERS = (
    ("CMC1", "MP1", "IP", "FT1"),
    ("MP2", "PP2", "DP2", "FT2"),
    ("MP3", "PP3", "DP3", "FT3"),
    ("MP4", "PP4", "DP4", "FT4"),
    ("MP5", "PP5", "DP5", "FT5"),
)
_MARKER_STRIDE = 15
"""Only every 15th frame of the 150 Hz recordings is used, which gives ten frames per second."""
_RIGHT = 1


@dataclass(frozen=True)
class HandPoses:
    """Hand angles from one source, with its licence."""

    name: str  # Name of the source.
    licence: str  # Licence and attribution.
    angles: np.ndarray  # (n, A) radians.


def load_sources(folder: Path | str) -> tuple[HandPoses, ...]:
    """Return the poses from all sources in the hand data folder.

    Raises:
        FileMissing: a source is missing.
    """
    folder = Path(folder)
    return (_godot(folder), _keyed(folder), _markers(folder))


def _godot(folder: Path) -> HandPoses:
    """Return the named poses of one hand. The other hand is its mirror image."""
    arrays = read_npz(folder / "godot_xr_hand_poses.npz")
    names, parents = [str(n) for n in arrays["bones"]], arrays["parents"].astype(int)
    G, place = [], []
    local, offsets = _matrices(arrays["pose_xyzw"][0]), arrays["offsets"][0]
    for b, p in enumerate(parents):
        G.append(local[:, b] if p < 0 else G[p] @ local[:, b])
        place.append(np.broadcast_to(offsets[b], (len(local), 3)) if p < 0 else place[p] + G[p] @ offsets[b])
    columns = [names.index("Wrist")]
    for f, finger in enumerate(_GODOT):
        columns += [names.index(f"{finger}_{joint}") for joint in _GODOT_JOINTS[min(f, 1)]]
    points = np.stack([place[c] for c in columns], axis=1)
    return HandPoses("godot-xr-tools", "CC0 1.0", measure_angles(points, 0))


def _keyed(folder: Path) -> HandPoses:
    """Return the distinct poses of both hands in Mesh2Motion's clips."""
    arrays = read_npz(folder / "mesh2motion_fingers.npz")
    names = [str(n) for n in arrays["joints"]]
    turns = np.concatenate([arrays["rotation_xyzw"], arrays["still_xyzw"]])
    found = []
    for side, letter in enumerate("LR"):
        columns = np.array([[names.index(f"DEF-{f}.0{k}.{letter}") for k in (1, 2, 3)] for f in _KEYED])
        local, offsets = _matrices(turns[:, columns]), arrays["offsets"][columns]
        points = [np.zeros((len(turns), 1, 3))]
        for f in range(5):
            G, place = local[:, f, 0], np.broadcast_to(offsets[f, 0], (len(turns), 3))
            chain = [place]
            for k in (1, 2):
                place = place + G @ offsets[f, k]
                G = G @ local[:, f, k]
                chain.append(place)
            points.append(np.stack([*chain, place + _KEYED_TIP * (G @ offsets[f, 2])], axis=1))
        found.append(measure_angles(np.concatenate(points, axis=1), side))
    return HandPoses("Mesh2Motion", "CC0 1.0", _distinct(np.concatenate(found)))


def _markers(folder: Path) -> HandPoses:
    """Measure the finger angles in frames of the finger-exercise recordings without missing markers."""
    found = []
    for path in sorted((folder / "leap").glob("*.npz")):
        points = marker_points(read_npz(path))[::_MARKER_STRIDE]
        found.append(measure_angles(points[np.isfinite(points).all((1, 2))], _RIGHT))
    if not found:
        raise FileMissing("The recordings of finger exercises are missing.", where=str(folder / "leap"))
    licence = "CC BY 4.0: Ganguly, Rashidi and Mombaur 2021, Sensors 21, 1750"
    return HandPoses("Leap and motion capture", licence, np.concatenate(found))


def marker_points(arrays: dict[str, Any]) -> np.ndarray:
    """Return ``HAND_POINTS`` (F, 21, 3) in metres from markers on the back of a hand, NaN if missing."""
    labels, recorded = [str(n) for n in arrays["labels"]], arrays["positions_01mm"].astype(np.float64)
    recorded = np.where(recorded == np.iinfo(np.int16).min, np.nan, recorded) * 1e-4
    wrist = 0.5 * (recorded[:, labels.index("RS")] + recorded[:, labels.index("US")])
    columns = [labels.index(name) for finger in _MARKERS for name in finger]
    return np.concatenate([wrist[:, None], recorded[:, columns]], axis=1)


def _distinct(angles: np.ndarray) -> np.ndarray:
    """Return one row of angles for each combination of whole degrees."""
    return angles[np.unique(np.round(np.rad2deg(angles)), axis=0, return_index=True)[1]]


def _matrices(xyzw: np.ndarray) -> np.ndarray:
    return matrix_from_quat(np.roll(xyzw.astype(np.float64), 1, axis=-1))


RANGES_DEG = {
    "mcp_flexion": (-30.0, 95.0),
    "mcp_spread": (-28.0, 28.0),
    "pip_flexion": (-10.0, 110.0),
    "dip_flexion": (-15.0, 90.0),
    "thumb_cmc_flexion": (-40.0, 45.0),
    "thumb_cmc_spread": (-10.0, 60.0),
    "thumb_cmc_twist": (-40.0, 40.0),
    "thumb_mcp_flexion": (-20.0, 70.0),
    "thumb_ip_flexion": (-30.0, 90.0),
}
"""Active ranges of healthy adults and the hyperextension of supple adults in degrees, rounded outwards (American
Academy of Orthopaedic Surgeons 1965, Hume et al. 1990), by the end of the angle's name."""
OWN_SIGMA_DEG = 5.0  # Smallest independent deviation of each angle, because there are few sources.
TWIST_SIGMA_DEG = 15.0  # Standard deviation of the thumb's twist, which joint centres do not show.
HELD = 0.95
"""Fraction of each source's poses that lie inside the ellipsoid of this probability. It scales the covariance."""

_CARD = """# Hand prior

This prior is a Gaussian over the {angles} angles of a hand, with the range of each joint. Its mean is the relaxed pose
of fingers that are not visible.

## Data and licence

| source | poses | licence |
|---|---|---|
{sources}

Angles were measured from joint centres, or from markers on the back of the hand, and clipped to the ranges. All sources
have the same weight. Distal joints bend little in recordings but more in keyed poses, so their correlation with the
other joints is weak.

## Training

`{command}`

The covariance is scaled up by the smallest factor that puts 95 % of every source inside the 95 % ellipsoid.

## Validation

`held_percent` is the percentage of a source's poses within the 95 % ellipsoid learned from the other sources.

| metric | value |
|---|---|
{metrics}

## Angles

| angle | mean ° | deviation ° | range ° |
|---|---|---|---|
{rows}

Arrays' SHA-256: `{digest}`
"""


def train_hands(data: Path | str, out: Path | str) -> dict[str, float]:
    """Write ``hands.npz`` and ``hands.md``, and return the figures on the card.

    Args:
        data: folder that contains the hand data.
        out: folder for the weights and the card.

    Raises:
        FileMissing: a source is missing.
    """
    sources, (low, high) = load_sources(data), ranges()
    clipped = [np.clip(source.angles, low, high) for source in sources]
    mean, covariance = moments(clipped)
    inflation = max(1.0, *(_needed(angles, mean, covariance) for angles in clipped))
    covariance = inflation * covariance
    figures = {"inflation": inflation}
    for left_out, source in enumerate(sources):
        others = moments([c for i, c in enumerate(clipped) if i != left_out])
        held = squared_distances(clipped[left_out], others[0], inflation * others[1]) < chi_square(HELD)
        figures[f"held_percent/{source.name}"] = 100.0 * float(held.mean())
    values = np.sqrt(np.linalg.eigvalsh(covariance))[::-1] ** 2
    figures["synergies_for_90_percent"] = float(1 + np.searchsorted(np.cumsum(values) / values.sum(), 0.9))
    arrays = {"mean": mean, "covariance": covariance, "low": low, "high": high}
    command = "python -m training.hands --data FOLDER --out FOLDER"
    path = Path(out) / f"{PRIOR}.npz"
    digest = write_weights(
        path, PriorWeights(PRIOR, arrays, {"angles": ANGLES, "command": command, "metrics": figures})
    )
    write_text(path.with_suffix(".md"), _card(sources, arrays, figures, command, digest), overwrite=True)
    return figures


def ranges() -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper limits of the angles, each (A,), in radians."""
    found = [RANGES_DEG.get(name, RANGES_DEG.get(name.split("_", 1)[1], (0.0, 0.0))) for name in ANGLES]
    low, high = np.deg2rad(np.array(found)).T
    return low, high


def moments(sources: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean (A,) and the covariance (A, A) of hand angles from equally weighted sources.

    Differences between the sources' means count as variance. Each angle gets an added variance, because there are few
    sources.
    """
    mean = np.mean([angles.mean(0) for angles in sources], axis=0)
    covariance = np.mean([(angles - mean).T @ (angles - mean) / len(angles) for angles in sources], axis=0)
    own = np.full(NUM_ANGLES, np.deg2rad(OWN_SIGMA_DEG))
    own[ANGLES.index("thumb_cmc_twist")] = np.deg2rad(TWIST_SIGMA_DEG)
    return mean, covariance + np.diag(own**2)


def squared_distances(angles: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the squared Mahalanobis distances (n,) of angles (n, A)."""
    off = angles - mean
    return (off @ np.linalg.inv(covariance) * off).sum(1)


def chi_square(probability: float, dof: int = NUM_ANGLES) -> float:
    """Return the squared Mahalanobis radius that contains a given probability of a ``dof``-dimensional Gaussian.

    ``n (1 - 2/(9n) + z √(2/(9n)))³`` with n = ``dof`` (Wilson and Hilferty 1931), accurate to a hundredth.
    """
    z = {0.5: 0.0, 0.8: 0.8416, 0.95: 1.6449}[probability]
    return dof * (1 - 2 / (9 * dof) + z * np.sqrt(2 / (9 * dof))) ** 3


def _needed(angles: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the factor to scale a covariance by, so that it contains ``HELD`` of a source's poses."""
    return float(np.quantile(squared_distances(angles, mean, covariance), HELD)) / chi_square(HELD)


def _card(
    sources: Sequence[HandPoses], arrays: dict[str, np.ndarray], figures: dict[str, float], command: str, digest: str
) -> str:
    listed = "\n".join(f"| {s.name} | {len(s.angles)} | {s.licence} |" for s in sources)
    mean, low, high = (np.rad2deg(arrays[name]) for name in ("mean", "low", "high"))
    sigma = np.rad2deg(np.sqrt(np.diag(arrays["covariance"])))
    rows = "\n".join(
        f"| `{name}` | {mean[i]:.0f} | {sigma[i]:.0f} | {low[i]:.0f} to {high[i]:.0f} |"
        for i, name in enumerate(ANGLES)
    )
    metrics = "\n".join(f"| `{name}` | {value:.4g} |" for name, value in figures.items())
    return _CARD.format(angles=NUM_ANGLES, sources=listed, command=command, metrics=metrics, rows=rows, digest=digest)
