"""Where the wand was, and where it should go next: cells of pictures and of the volume that were not seen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.types import Cameras
from solver_backend.types.shapes import Float, Int

COLUMNS, ROWS = 6, 4
"""Cells of each picture."""
LEAST_IN_CELL = 5
"""Sightings with which a cell of a picture counts as covered."""
CELL_M = 0.5
"""Edge of the volume's cells."""
_ACROSS, _DOWN = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass
class Coverage:
    """Counts that grow while the wand is waved; ``add`` is what a live view calls for each moment."""

    names: tuple[str, ...]
    """C sensors."""
    size_px: Int[np.ndarray, "views 2"]
    """(C, 2) width and height."""
    pictures: np.ndarray = field(init=False)
    """(C, ROWS, COLUMNS) sightings."""
    volume: dict[tuple[int, int, int], int] = field(init=False, default_factory=dict)
    """Moments by cell of ``CELL_M`` in which the wand was located."""

    def __post_init__(self) -> None:
        self.pictures = np.zeros((len(self.names), ROWS, COLUMNS), dtype=np.int64)

    def add(self, px: Float[np.ndarray, "views moments 2"], at: Float[np.ndarray, "moments 3"] | None = None) -> None:
        """Count moments.

        Args:
            px: (C, M, 2) where the wand is, NaN where a sensor does not see it.
            at: (M, 3) metres, where sensors stand is known already; NaN where it is not located.
        """
        view, moment = np.nonzero(np.isfinite(px).all(-1))
        share = px[view, moment] / self.size_px[view]
        cell = np.clip((share * [COLUMNS, ROWS]).astype(int), 0, [COLUMNS - 1, ROWS - 1])
        np.add.at(self.pictures, (view, cell[:, 1], cell[:, 0]), 1)
        if at is None:
            return
        cells, counts = np.unique(np.floor(at[np.isfinite(at).all(1)] / CELL_M).astype(int), axis=0, return_counts=True)
        for key, count in zip(map(tuple, cells.tolist()), counts.tolist(), strict=True):
            self.volume[key] = self.volume.get(key, 0) + count

    @property
    def shares(self) -> Float[np.ndarray, " views"]:
        """(C,) share of each picture's cells that are covered."""
        return (self.pictures >= LEAST_IN_CELL).mean(axis=(1, 2))

    @property
    def volume_m3(self) -> float:
        """Volume of the cells in which the wand was located."""
        return len(self.volume) * CELL_M**3

    def next_place(self) -> str:
        """Return the part of a picture to wave in, of the sensor that saw least; "" when all is covered."""
        open_cells = self.pictures < LEAST_IN_CELL
        if not open_cells.any():
            return ""
        c = int(np.argmax(open_cells.sum(axis=(1, 2))))
        rows, columns = np.nonzero(open_cells[c])
        # Thirds of the picture, the one with most open cells first.
        parts = 3 * (rows * 3 // ROWS) + columns * 3 // COLUMNS
        down, across = divmod(int(np.bincount(parts, minlength=9).argmax()), 3)
        place = "middle" if down == across == 1 else f"{_DOWN[down]} {_ACROSS[across]}"
        return f"Wave in the {place} of what {self.names[c]} sees: {1 - self.shares[c]:.0%} of its picture is open."

    def lines(self) -> list[str]:
        """Return a row for each sensor: its picture's cells, ``#`` covered, ``+`` seen, ``.`` open."""
        rows = []
        for name, grid, share in zip(self.names, self.pictures, self.shares, strict=True):
            marks = ["".join("#" if n >= LEAST_IN_CELL else "+" if n else "." for n in row) for row in grid]
            rows.append(f"{name:<11} {share:4.0%} of the picture  {' '.join(marks)}")
        return rows


def coverage_of(
    cameras: Cameras, px: Float[np.ndarray, "views moments lights 2"], at: Float[np.ndarray, "moments lights 3"]
) -> Coverage:
    """Return the coverage of a whole recording, by the wand's middle."""
    found = Coverage(cameras.names, cameras.image_size)
    found.add(px.mean(axis=2), at.mean(axis=1))
    return found
