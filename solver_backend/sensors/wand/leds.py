"""A straight wand with three lights at unequal distances, and how its lights are distinguished in a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.sensors.wand.errors import WandInvalid
from solver_backend.types.shapes import Float

SURE_SHARE = 0.43
"""Where the shorter part is seen as more than this share of the wand, its ends are not distinguished."""
STRAIGHT = 0.03
"""The middle light may be off the line of the others by this share of the wand, as it is seen, ..."""
STRAIGHT_SIGMAS = 4.0
"""... or by this many standard deviations of a pixel position."""
SHORTEST_M, LONGEST_M = 0.02, 5.0


@dataclass(frozen=True)
class Wand:
    """Distances between neighbouring lights, metres."""

    first_m: float
    """From the first light to the middle one."""
    second_m: float
    """From the middle light to the third."""

    def __post_init__(self) -> None:
        lengths = np.array([self.first_m, self.second_m])
        if not (np.isfinite(lengths).all() and (lengths > SHORTEST_M).all() and (lengths < LONGEST_M).all()):
            raise WandInvalid(
                f"The wand's lights are {self.first_m} and {self.second_m} m apart; "
                f"{SHORTEST_M} to {LONGEST_M} m are possible.", hint="Lengths are in metres: --wand 0.13 0.26",
            )  # fmt: skip
        if self.short_share > SURE_SHARE - 0.03:
            raise WandInvalid(
                f"The wand's parts of {self.first_m:.3f} and {self.second_m:.3f} m are too alike to "
                "distinguish its ends.",
                hint="Put the middle light at a third of the wand, as 0.13 and 0.26 m.",
            )

    @property
    def short_share(self) -> float:
        """The shorter part's share of the wand."""
        return min(self.first_m, self.second_m) / (self.first_m + self.second_m)

    @property
    def lights(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) metres, the lights on the X axis about their mean."""
        x = np.array([0.0, self.first_m, self.first_m + self.second_m])
        return np.stack([x - x.mean(), np.zeros(3), np.zeros(3)], axis=1)

    @property
    def distances_m(self) -> Float[np.ndarray, " 3"]:
        """(3,) first to middle, middle to third, first to third."""
        return np.array([self.first_m, self.second_m, self.first_m + self.second_m])


def distances(lights: Float[np.ndarray, "*batch 3 axes"]) -> Float[np.ndarray, "*batch 3"]:
    """Return the distances first to middle, middle to third, first to third of lights in their order."""
    return np.linalg.norm(lights[..., [1, 2, 2], :] - lights[..., [0, 1, 0], :], axis=-1)


def identified(wand: Wand, flat: Float[np.ndarray, "frames 3 2"], sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which of three spots is which light, (F, 3) indices, and whether that is sure, (F,).

    The middle light lies between the others; of the ends, the one on the shorter part's side is nearer to it, which
    perspective turns around only where the wand points at the camera.

    Args:
        wand: its lengths.
        flat: (F, 3, 2) undistorted normalised coordinates in any order, NaN where there are fewer.
        sigma: standard deviation of a coordinate, normalised units.
    """
    rows = np.arange(len(flat))
    known = np.isfinite(flat).all((-1, -2))
    spots = np.where(known[:, None, None], flat, 0.0)
    # Of three points on a line the middle one is opposite to the longest distance.
    across = np.linalg.norm(spots[:, [1, 2, 0]] - spots[:, [2, 0, 1]], axis=-1)
    middle = np.argmax(across, axis=1)
    ends = (middle[:, None] + np.array([1, 2])) % 3
    parts = np.linalg.norm(spots[rows[:, None], ends] - spots[rows, middle][:, None], axis=-1)
    swap = (parts[:, 0] > parts[:, 1]) != (wand.first_m > wand.second_m)
    ends = np.where(swap[:, None], ends[:, ::-1], ends)
    order = np.stack([ends[:, 0], middle, ends[:, 1]], axis=1)
    first, mid, third = (spots[rows, order[:, i]] for i in range(3))
    length = np.linalg.norm(third - first, axis=-1)
    along = (third - first) / np.maximum(length, 1e-12)[:, None]
    arm = mid - first
    off = np.abs(along[:, 0] * arm[:, 1] - along[:, 1] * arm[:, 0])
    straight = off < np.maximum(STRAIGHT * length, STRAIGHT_SIGMAS * sigma)
    sure = parts.min(axis=1) < SURE_SHARE * parts.sum(axis=1)
    return order, known & straight & sure & (length > 8.0 * sigma)


def in_order(px: Float[np.ndarray, "frames 3 2"], order: np.ndarray, sure: np.ndarray) -> np.ndarray:
    """Return (F, 3, 2) spots as lights in the wand's order, NaN where it is not sure which they are."""
    return np.where(sure[:, None, None], np.take_along_axis(px, order[..., None], axis=1), np.nan)


def middle_from_lights(wand: Wand, flat: Float[np.ndarray, "frames 3 2"]) -> Float[np.ndarray, "frames 3"]:
    """Return where the middle light is, (F, 3) metres in a camera's axes, from one picture of the wand.

    Lights on a line, ``z₂ r₂ = (1 - q) z₁ r₁ + q z₃ r₃`` with ``q = d₁₂ / d₁₃``, give the proportions of their depths
    (the null vector of three rays), the wand's length their size. Depths are rough; ways across the sight are sure.

    Args:
        wand: its lengths.
        flat: (F, 3, 2) undistorted normalised coordinates of the lights in their order, NaN where not seen.
    """
    known = np.isfinite(flat).all((-1, -2))
    spots = np.where(known[:, None, None], flat, np.array([[-0.1, 0.0], [0.0, 0.0], [0.2, 0.0]]))
    rays = np.concatenate([spots, np.ones((*spots.shape[:2], 1))], axis=-1)
    q = wand.first_m / wand.distances_m[2]
    rows = rays * np.array([1.0 - q, -1.0, q])[:, None]
    z = np.linalg.svd(np.swapaxes(rows, 1, 2))[2][:, -1]
    z = z * np.sign(z[:, 1:2] + 1e-12)
    length = np.linalg.norm(z[:, 2:] * rays[:, 2] - z[:, :1] * rays[:, 0], axis=-1)
    size = wand.distances_m[2] / np.maximum(length, 1e-9)
    return np.where(known[:, None], (size * z[:, 1])[:, None] * rays[:, 1], np.nan)
