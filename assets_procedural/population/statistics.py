"""Compute population statistics from the ANSUR II survey.

``python -m assets_procedural.population.statistics ANSUR_II_BOTH_Public.csv`` writes the table.

The table contains only means, deviations, percentiles and correlations. Men and women each have half the weight.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from assets_procedural.arrays import NUMBERS, Array, edges_of, table
from assets_procedural.layout import JOINT
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.verb import output, parse_script, place

# ANSUR II's names for the measures that drive the shape components: nine lengths, then eleven girths.
_LENGTHS = "stature cervicaleheight crotchheight kneeheightmidpatella span biacromialbreadth radialestylionlength"
_GIRTHS = "head neck chest waist buttock thigh calf ankle"
MEASURES = (
    *_LENGTHS.split(),
    "handlength",
    "footlength",
    *(f"{part}circumference" for part in _GIRTHS.split()),
    "bicepscircumferenceflexed",
    "forearmcircumferenceflexed",
    "wristcircumference",
)
NUM_LENGTHS = 9  # Number of lengths in ``MEASURES``.


@dataclass(frozen=True)
class Statistics:
    """Mean, standard deviation, 1st and 99th percentiles (metres) and correlation of the measures."""

    mean: np.ndarray
    sd: np.ndarray
    p01: np.ndarray
    p99: np.ndarray
    correlation: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (M, M) of the measures in square metres."""
        return self.correlation * np.outer(self.sd, self.sd)


def load_statistics(path: Path = NUMBERS / "ansur_statistics.json") -> Statistics:
    """Read the committed table of statistics. Raise ``FileDamaged`` if it has other measures than ``MEASURES``."""
    table = json.loads(path.read_text())
    if tuple(table["measures"]) != MEASURES:
        raise FileDamaged(f"The table lists {table['measures']}, but {list(MEASURES)} are expected.", where=str(path))
    return Statistics(*(np.array(table[key]) for key in ("mean", "sd", "p01", "p99", "correlation")))


def summarise(values: np.ndarray, is_male: np.ndarray) -> Statistics:
    """Return the statistics of (N, M) values in metres. Men and women each have half the weight."""
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
    """Compute ``numbers/ansur_statistics.json`` from the table of the ANSUR II survey."""
    survey = place("path", "survey", "SURVEY.csv", "Table of the survey")
    out = output("OUT.json", "Table to write", NUMBERS / "ansur_statistics.json")
    arguments = parse_script(__doc__, survey, out)
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


@dataclass(frozen=True)
class Tape:
    """A closed chain of points ``(1 - t) v_i + t v_j`` on the edges of a mesh."""

    i: Array
    j: Array
    t: Array

    def points(self, vertices: Array) -> Array:
        """Return the points (P, 3) of the tape on a shaped or posed mesh, in metres."""
        return (1.0 - self.t)[:, None] * vertices[self.i] + self.t[:, None] * vertices[self.j]

    def length(self, vertices: Array) -> float:
        """Return the length of the tape (a circumference) on a mesh, in metres."""
        points = self.points(vertices)
        return float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())


@dataclass(frozen=True)
class Measures:
    """Landmark vertices and tapes of a mesh. They are valid for all its shapes."""

    top: int
    sole: int
    crotch: int
    fingertip: int
    toe: int
    heel: int
    tapes: dict[str, Tape]
    straightened: float  # Length of the hand with straight fingers, relative to this mesh.

    def __call__(self, vertices: Array, joints: Array) -> Array:
        """Return the measures (M,) in metres, in the order of ``MEASURES``."""

        def y(name: str) -> float:
            return float(joints[JOINT[name], 1])

        def x(name: str) -> float:
            return float(joints[JOINT[name], 0])

        floor = vertices[self.sole, 1]
        hand = self.straightened * (vertices[self.fingertip, 0] - x("left_wrist"))
        values = {
            "stature": vertices[self.top, 1] - floor,
            "cervicaleheight": y("neck") - floor,
            "crotchheight": vertices[self.crotch, 1] - floor,
            "kneeheightmidpatella": y("left_knee") - floor,
            "span": 2.0 * (x("left_wrist") + hand),
            "biacromialbreadth": 2.0 * x("left_shoulder"),
            "radialestylionlength": x("left_wrist") - x("left_elbow"),
            "handlength": hand,
            "footlength": vertices[self.toe, 2] - vertices[self.heel, 2],
        }
        values |= {name: tape.length(vertices) for name, tape in self.tapes.items()}
        return np.array([values[name] + OFFSETS.get(name, 0.0) for name in MEASURES])

    def jacobian(self, vertices: Array, joints: Array, moved: Array, moved_joints: Array) -> Array:
        """Return the derivatives (M, K) of the measures w.r.t. K displacement fields, by central differences."""
        step, columns = 0.01, []
        for dv, dj in zip(moved, moved_joints, strict=True):
            ahead = self(vertices + step * dv, joints + step * dj)
            back = self(vertices - step * dv, joints - step * dj)
            columns.append((ahead - back) / (2 * step))
        return np.stack(columns, axis=1)


OFFSETS = {"biacromialbreadth": 0.047, "radialestylionlength": 0.020, "cervicaleheight": 0.004}
"""Metres added to measured lengths, because landmarks on the skin are not joint centres. Chosen by hand."""


def place_measures(vertices: Array, faces: Array, joints: Array, straightened: float = 1.0) -> Measures:
    """Find the landmarks and tapes of a mesh at rest that is about 1.70 m tall.

    ``straightened`` is the length of the hand with straight fingers, relative to this mesh.
    """
    left = vertices[:, 0] > 0.0
    midline = np.nonzero((np.abs(vertices[:, 0]) < 1e-9) & (vertices[:, 1] > 0.5))[0]
    foot = np.nonzero(left & (vertices[:, 1] < 0.08))[0]
    return Measures(
        top=int(np.argmax(vertices[:, 1])),
        sole=int(np.argmin(vertices[:, 1])),
        crotch=int(midline[np.argmin(vertices[midline, 1])]),
        fingertip=int(np.argmax(vertices[:, 0])),
        toe=int(foot[np.argmax(vertices[foot, 2])]),
        heel=int(foot[np.argmin(vertices[foot, 2])]),
        tapes={
            name: place_tape(vertices, faces, normal, (x, y, z + joints[JOINT["neck"], 2]), box)
            for name, (normal, (x, y, z), box) in table("tapes").items()
        },
        straightened=straightened,
    )


def place_tape(
    vertices: Array, faces: Array, normal: tuple[float, ...], through: tuple[float, ...], box: float = 0.0
) -> Tape:
    """Place a measuring tape around the convex hull of a plane section, because a tape spans hollows."""
    n = np.array(normal) / np.linalg.norm(normal)
    edges = edges_of(faces)
    height = (vertices - np.array(through)) @ n
    a, b = height[edges[:, 0]], height[edges[:, 1]]
    cut = (a * b <= 0) & (a != b)
    i, j, t = edges[cut, 0], edges[cut, 1], (a[cut] / (a - b)[cut])
    points = (1.0 - t)[:, None] * vertices[i] + t[:, None] * vertices[j]
    keep = np.abs(points[:, 0]) < box if box > 0 else points[:, 0] > 0
    plane = np.linalg.svd(n[None])[2][1:]
    chosen = np.nonzero(keep)[0][ConvexHull(points[keep] @ plane.T).vertices]
    return Tape(i[chosen], j[chosen], t[chosen])
