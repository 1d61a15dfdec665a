"""Folders of landmark row trainings: build/landmark_rows/ROW_SEED, each with its ``figures.json``."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[3] / "build" / "landmark_rows"
SETS = ("ordinary", "tail", "floor")
"""Sets of poses, as in ``training.landmarks.rows``, which needs torch."""


def folder_of(root: Path, row: str, seed: int) -> Path:
    """Return the folder of a row's training."""
    return root / f"{row.replace(' ', '-')}_{seed}"


def trained(root: Path) -> dict[tuple[str, int], Path]:
    """Return the folders of finished trainings, by row and seed."""
    found = {}
    for path in sorted(root.glob("*_*/figures.json")):
        row, _, seed = path.parent.name.rpartition("_")
        if seed.isdigit():
            found[row.replace("-", " "), int(seed)] = path.parent
    return found
