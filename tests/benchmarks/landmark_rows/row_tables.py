"""Tables 4.1 to 4.6 of the thesis from the figures that trained rows left: a table for every set of poses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from training.landmarks.rows import LIMBS, SETS

PCK_LIMITS_CM = (1, 3, 7)


def read_figures(folders: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """Return what each row's training left (``figures.json`` of its folder), by row."""
    return {name: json.loads((folder / "figures.json").read_text()) for name, folder in folders.items()}


def row_tables(rows: Mapping[str, Mapping[str, Any]], base: str, kind: str = "fixed") -> str:
    """Return one Markdown table for every set: RMSE and MPJPE (mm), their ratio to the base's, PCK (%).

    Args:
        rows: of ``read_figures``.
        base: row that ratios are to.
        kind: ``thesis`` (53 markers under its eqs. 4.20 to 4.27 alone), ``fixed`` (53 markers under ours), or ``any``,
            which networks of points alone know.
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
