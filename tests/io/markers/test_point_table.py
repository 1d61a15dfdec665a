"""Tables of 3D points: one heading row, two, or a row a point; what is none of them is left to others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.markers.point_table import begins_as_points, read_point_table
from solver_backend.io.markers.read import read_markers
from tests.support.marker_reading import taken

NAMES = ("LASI", "RASI", "C7", "left ankle", "R.Heel")
POINTS = np.random.default_rng(3).uniform(-1.0, 1.9, (4, len(NAMES), 3)).round(4)
"""Metres, Z up."""


def table(headings: list[list[str]], rows: list[list[str]], separator: str = ",") -> str:
    return "\n".join(separator.join(row) for row in [*headings, *rows]) + "\n"


def wide(first: tuple[str, ...] = ("frame", "time"), points: np.ndarray = POINTS) -> list[list[str]]:
    cells = {"frame": lambda f: str(7 + f), "time": lambda f: f"{f / 50:.2f}", "": lambda f: str(f)}
    return [[*(cells[name](f) for name in first), *(f"{v:g}" for v in points[f].ravel())] for f in range(len(points))]


@pytest.mark.parametrize("form", ["{}_{}", "{}.{}", "{}:{}", "{} {}", "{}[{}]", "{}-{}", "{}{}", "{}_{} (m)"])
def test_one_heading_row(tmp_path: Path, form: str) -> None:
    axis = "XYZ" if form in ("{}.{}", "{}{}") else "xyz"
    headings = ["frame", "time", *(form.format(name, a) for name in NAMES for a in axis)]
    path = tmp_path / "points.csv"
    path.write_text(table([headings], wide()))
    found = read_markers(path, unit="m", up_axis="z")
    assert (found.cloud.labels, found.cloud.fps) == (NAMES, 50.0)
    np.testing.assert_allclose(found.cloud.positions, POINTS)


@pytest.mark.parametrize("every", [False, True])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_names_above_the_axes(tmp_path: Path, separator: str, every: bool) -> None:
    """Spreadsheets name a point above its first column, DeepLabCut's 3D files above each, below the scorer's row."""
    names = ["bodyparts", "", *(n if every or k == 0 else "" for n in NAMES for k in range(3))]
    axes = ["coords", "Time", *(list("xyz") * len(NAMES))]
    scorer = [["scorer", *["net"] * (len(axes) - 1)]] if every else []
    comma = separator == ";"
    rows = [[cell.replace(".", ",") if comma else cell for cell in row] for row in wide(("", "time"))]
    path = tmp_path / "points.txt"
    path.write_text(table([*scorer, names, axes], rows, separator))
    found = read_markers(path, unit="m", up_axis="z")
    assert (found.cloud.labels, found.cloud.fps) == (NAMES, 50.0)
    np.testing.assert_allclose(found.cloud.positions, POINTS)


def test_a_row_a_point(tmp_path: Path) -> None:
    rows = [
        [str(f), name, *(f"{v:g}" for v in POINTS[f, m]), "good"]
        for f in (1, 0, 3, 2) for m, name in enumerate(NAMES) if (f, m) != (2, 1)
    ]  # fmt: skip
    path = tmp_path / "long.csv"
    path.write_text(table([["frame", "keypoint", "x", "y", "z", "quality"]], rows))
    found = taken(read_point_table, path, fps=30.0, unit="m", up_axis="z").cloud
    expected = POINTS.copy()
    expected[2, 1] = np.nan
    assert found.fps == 30.0 and found.labels == NAMES
    np.testing.assert_allclose(found.positions, expected)


def test_other_quantities_and_words_are_left_out(tmp_path: Path) -> None:
    """anipose writes an error, a score and a count beside each point, and matrices and words at the end."""
    headings = [f"{n}_{q}" for n in NAMES for q in ("x", "y", "z", "error", "ncams", "score")] + ["M_00", "fnum", "who"]
    rows = [
        [c for p in POINTS[f] for c in (*(f"{v:g}" for v in p), "0.5", "3", "0.9")] + ["1.0", str(f), "Ann"]
        for f in range(4)
    ]
    path = tmp_path / "pose-3d.csv"
    path.write_text(table([headings], rows))
    found = taken(read_point_table, path, fps=30.0, unit="m", up_axis="z")
    assert found.cloud.labels == NAMES
    np.testing.assert_allclose(found.cloud.positions, POINTS)


def test_a_missing_point_is_blank(tmp_path: Path) -> None:
    headings = ["time", *(f"{name}_{a}" for name in NAMES for a in "xyz")]
    rows = wide(("time",))
    rows[1][4:7] = ["", "nan", "NaN"]
    path = tmp_path / "points.csv"
    path.write_text(table([headings], rows))
    found = taken(read_point_table, path, unit="m", up_axis="z").cloud.positions
    assert np.isnan(found[1, 1]).all() and np.isfinite(found).sum() == POINTS.size - 3


@pytest.mark.parametrize(
    "head",
    [
        "nose.x,nose.y,nose.score,tail.x,tail.y,tail.score\n1,2,1,3,4,1\n",
        "frame,Fx,Fy,Fz\n0,1,2,3\n", "1,2,3,4\n5,6,7,8\n", "", "x,y,z\n1,2,3\n", "frame,name,x,y\n0,a,1,2\n",
        "time\tpelvis_tilt\tpelvis_list\n0\t1\t2\n",
    ],
)  # fmt: skip
def test_what_is_no_table_of_points(head: str) -> None:
    assert not begins_as_points(head)


def test_damage_is_named(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    headings = [[f"{name}_{a}" for name in NAMES for a in "xyz"]]
    path.write_text(table(headings, wide(())))
    with pytest.raises(FileDamaged, match="does not state a frame rate"):
        taken(read_point_table, path)
    path.write_text(table(headings, wide(())).replace(f"{POINTS[2, 0, 0]:g}", "abc"))
    with pytest.raises(FileDamaged, match="'abc' is not a number.*line 4"):
        taken(read_point_table, path, fps=30.0)
    path.write_text("1,2,3\n")
    with pytest.raises(FileDamaged, match="does not name its points"):
        taken(read_point_table, path)
    long = [["time", "marker", "x", "y", "z"]]
    path.write_text(table(long, [["", "LASI", "1", "2", "3"]]))
    with pytest.raises(FileDamaged, match="have no frame number"):
        taken(read_point_table, path, fps=30.0)
    path.write_text(table(long, [["0", "LASI", "1", "abc", "3"]]))
    with pytest.raises(FileDamaged, match="'abc' is not a number.*line 2"):
        taken(read_point_table, path, fps=30.0)
    path.write_text(
        table(long, [["0", "LASI", "1", "2", "3"], ["0", "C7", "1", "2", "3"], ["0", "LASI", "4", "5", "6"]])
    )
    with pytest.raises(FileDamaged, match="'LASI' occurs twice in one frame.*line 4.*one table for each person"):
        taken(read_point_table, path, fps=30.0)


def test_decimal_commas_between_commas_are_quoted(tmp_path: Path) -> None:
    headings = [["time", *(f"{name}_{a}" for name in NAMES for a in "xyz")]]
    rows = [[f'"{cell.replace(".", ",")}"' for cell in row] for row in wide(("time",))]
    path = tmp_path / "points.csv"
    path.write_text(table(headings, rows))
    np.testing.assert_allclose(taken(read_point_table, path, unit="m", up_axis="z").cloud.positions, POINTS)
