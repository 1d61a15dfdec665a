"""Tables 4.1 to 4.6 of the thesis from the figures of trained rows, with a table for every set of poses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from training.landmarks.rows import LIMBS, SETS

PCK_LIMITS_CM = (1, 3, 7)


def read_figures(folders: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """Return the contents of each row's ``figures.json``, by row."""
    return {name: json.loads((folder / "figures.json").read_text()) for name, folder in folders.items()}


def row_tables(rows: Mapping[str, Mapping[str, Any]], base: str, kind: str = "fixed") -> str:
    """Return one Markdown table for every set: RMSE and MPJPE (mm), their ratio to the base's, PCK (%).

    Args:
        rows: rows of ``read_figures``.
        base: row to which ratios refer.
        kind: ``thesis`` (53 markers with only its eqs. 4.20 to 4.27), ``fixed`` (53 markers with our corruptions), or
            ``any``, which only point networks support.
    """
    return "\n\n".join(f"### {where}, clouds: {kind}\n\n{_table(rows, base, f'{kind} {where}')}" for where in SETS)


def _table(rows: Mapping[str, Mapping[str, Any]], base: str, where: str) -> str:
    limbs = [(cm, limb) for cm in PCK_LIMITS_CM for limb in LIMBS]
    names = ["row", "RMSE mm", "ratio", "MPJPE mm", "ratio", *(f"PCK{cm} {limb}" for cm, limb in limbs)]
    lines = ["| " + " | ".join(names) + " |", "|---" * len(names) + "|"]
    against = rows[base]["chosen"][where]
    for name, row in rows.items():
        mine = row["chosen"][where]
        cells = [name]
        for key in ("rmse_mm", "mpjpe_mm"):
            cells += [f"{mine[key]:.1f}", f"{mine[key] / against[key]:.3f}"]
        cells += [f"{mine[f'pck{cm}_{limb}']:.1f}" for cm, limb in limbs]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
