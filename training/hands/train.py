"""Learn the prior of hands: ``python -m training.hands --data FOLDER --out FOLDER``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.body.hand_angles import ANGLES, NUM_ANGLES
from solver_backend.exchange.outputs import write_text
from solver_backend.priors.hand_prior import PRIOR
from solver_backend.priors.weights import PriorWeights, write_weights
from training.hands.sources import HandPoses, load_sources

RANGES_DEG = {
    "mcp_flexion": (-30.0, 95.0), "mcp_spread": (-28.0, 28.0), "pip_flexion": (-10.0, 110.0),
    "dip_flexion": (-15.0, 90.0),
    "thumb_cmc_flexion": (-40.0, 45.0), "thumb_cmc_spread": (-10.0, 60.0), "thumb_cmc_twist": (-40.0, 40.0),
    "thumb_mcp_flexion": (-20.0, 70.0), "thumb_ip_flexion": (-30.0, 90.0),
}  # fmt: skip
"""Active ranges of healthy adults and the hyperextension of supple ones, rounded outwards (American Academy of
Orthopaedic Surgeons 1965; Hume et al. 1990), by the end of the angle's name."""
OWN_SIGMA_DEG = 5.0
"""What each angle does for itself at least: nothing that a few sources have in common is a law."""
TWIST_SIGMA_DEG = 15.0
"""Of the thumb's twist, which joint centres do not show."""
HELD = 0.95
"""Share of every source's poses in the ellipsoid of that probability: the covariance is as small as that allows."""

_CARD = """# Prior of hands

A Gaussian of the {angles} angles of a hand, and the range of each joint. Its mean is the relaxed hand in which fingers
rest that nobody sees.

## Data and licence

| source | poses | licence |
|---|---|---|
{sources}

Angles were measured from joint centres, or from markers on the back of the hand, and cut to the ranges. Sources count
alike. Recorded distal joints hardly bend and keyed ones do, so that they follow the others weakly.

## Training

`{command}`

The covariance is multiplied by the least number with which the ellipsoid of 95 % holds 95 % of every source.

## Validation

Share of the poses of each source within the 95 % ellipsoid that is learned from the others.

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
    """Write ``hands.npz`` and ``hands.md``, and return the figures of the card.

    Args:
        data: the folder of hands.
        out: folder of weights and card.

    Raises:
        FileMissing: a source is not there.
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
    """Return (A,) low and high ends of the angles' ranges, radians."""
    found = [RANGES_DEG.get(name, RANGES_DEG.get(name.split("_", 1)[1], (0.0, 0.0))) for name in ANGLES]
    low, high = np.deg2rad(np.array(found)).T
    return low, high


def moments(sources: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (A,) and covariance (A, A) of sources that count alike, each angle with a variance of its own added.

    Sources are of right and left hands, people and animators: their means differ, and that counts as spread.
    """
    mean = np.mean([angles.mean(0) for angles in sources], axis=0)
    covariance = np.mean([(angles - mean).T @ (angles - mean) / len(angles) for angles in sources], axis=0)
    own = np.full(NUM_ANGLES, np.deg2rad(OWN_SIGMA_DEG))
    own[ANGLES.index("thumb_cmc_twist")] = np.deg2rad(TWIST_SIGMA_DEG)
    return mean, covariance + np.diag(own**2)


def squared_distances(angles: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return (n,) Mahalanobis' squared distances of angles (n, A)."""
    off = angles - mean
    return (off @ np.linalg.inv(covariance) * off).sum(1)


def chi_square(probability: float, dof: int = NUM_ANGLES) -> float:
    """Return the squared distance within which a Gaussian of so many dimensions lies with this probability.

    ``n (1 - 2/(9n) + z √(2/(9n)))³`` (Wilson and Hilferty 1931), to a hundredth.
    """
    z = {0.5: 0.0, 0.8: 0.8416, 0.95: 1.6449}[probability]
    return dof * (1 - 2 / (9 * dof) + z * np.sqrt(2 / (9 * dof))) ** 3


def _needed(angles: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return by how much a covariance must grow to hold the poses of a source."""
    return float(np.quantile(squared_distances(angles, mean, covariance), HELD)) / chi_square(HELD)


def _card(
    sources: Sequence[HandPoses], arrays: dict[str, np.ndarray], figures: dict[str, float], command: str, digest: str
) -> str:
    """Return the model card."""
    listed = "\n".join(f"| {s.name} | {len(s.angles)} | {s.licence} |" for s in sources)
    mean, low, high = (np.rad2deg(arrays[name]) for name in ("mean", "low", "high"))
    sigma = np.rad2deg(np.sqrt(np.diag(arrays["covariance"])))
    rows = "\n".join(
        f"| `{name}` | {mean[i]:.0f} | {sigma[i]:.0f} | {low[i]:.0f} to {high[i]:.0f} |"
        for i, name in enumerate(ANGLES)
    )
    metrics = "\n".join(f"| `{name}` | {value:.4g} |" for name, value in figures.items())
    return _CARD.format(angles=NUM_ANGLES, sources=listed, command=command, metrics=metrics, rows=rows, digest=digest)
