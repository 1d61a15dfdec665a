"""Population statistics from the ANSUR II survey.

``python -m assets_procedural.population.statistics ANSUR_II_BOTH_Public.csv`` makes the table.

Only means, deviations, percentiles and correlations are kept. Men and women count half each.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets_procedural.surface.primitives import NUMBERS
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import write_text

MEASURES = (
    "stature",
    "cervicaleheight",
    "crotchheight",
    "kneeheightmidpatella",
    "span",
    "biacromialbreadth",
    "radialestylionlength",
    "handlength",
    "footlength",
    "headcircumference",
    "neckcircumference",
    "chestcircumference",
    "waistcircumference",
    "buttockcircumference",
    "thighcircumference",
    "calfcircumference",
    "anklecircumference",
    "bicepscircumferenceflexed",
    "forearmcircumferenceflexed",
    "wristcircumference",
)
"""ANSUR II's names of the measures that drive the shape components: nine lengths, then eleven girths."""
NUM_LENGTHS = 9
"""How many of ``MEASURES`` are lengths."""


@dataclass(frozen=True)
class Statistics:
    """Mean, standard deviation, 1st and 99th percentile (metres) and correlation of the measures."""

    mean: np.ndarray
    sd: np.ndarray
    p01: np.ndarray
    p99: np.ndarray
    correlation: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Return the (M, M) covariance, square metres."""
        return self.correlation * np.outer(self.sd, self.sd)


def load_statistics(path: Path = NUMBERS / "ansur_statistics.json") -> Statistics:
    """Read the committed table.

    Raises:
        FileDamaged: the table lists other measures than ``MEASURES``.
    """
    table = json.loads(path.read_text())
    if tuple(table["measures"]) != MEASURES:
        raise FileDamaged(f"The table lists {table['measures']}; {list(MEASURES)} are expected.", where=str(path))
    return Statistics(*(np.array(table[key]) for key in ("mean", "sd", "p01", "p99", "correlation")))


def summarise(values: np.ndarray, is_male: np.ndarray) -> Statistics:
    """Return the statistics of (N, M) values in metres, men and women weighing half each."""
    weight = np.where(is_male, 0.5 / is_male.sum(), 0.5 / (~is_male).sum())
    mean = weight @ values
    covariance = ((values - mean) * weight[:, None]).T @ (values - mean)
    sd = np.sqrt(np.diag(covariance))
    tails = np.stack([_weighted_quantiles(column, weight, (0.01, 0.99)) for column in values.T])
    return Statistics(mean, sd, tails[:, 0], tails[:, 1], covariance / np.outer(sd, sd))


def _weighted_quantiles(values: np.ndarray, weight: np.ndarray, levels: tuple[float, ...]) -> np.ndarray:
    order = np.argsort(values, kind="stable")
    return np.interp(levels, np.cumsum(weight[order]), values[order])


def main() -> None:
    """Write ``numbers/ansur_statistics.json`` from the survey's file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("survey", type=Path)
    parser.add_argument("--out", type=Path, default=NUMBERS / "ansur_statistics.json")
    arguments = parser.parse_args()
    with arguments.survey.open(encoding="latin-1", newline="") as stream:
        rows = list(csv.DictReader(stream))
    values = np.array([[float(row[name]) / 1000.0 for name in MEASURES] for row in rows])
    found = summarise(values, np.array([row["Gender"] == "Male" for row in rows]))
    table = {
        "source": "ANSUR II (US Army, 2012), 4,082 men and 1,986 women, each group weighing one half; metres",
        "measures": list(MEASURES),
        **{key: np.round(getattr(found, key), 5).tolist() for key in ("mean", "sd", "p01", "p99")},
        "correlation": np.round(found.correlation, 4).tolist(),
    }
    write_text(arguments.out, json.dumps(table, indent=1) + "\n", overwrite=True)


if __name__ == "__main__":
    main()
