"""Tables of markers as spreadsheets of several countries leave them: decimal commas, groups, errors as cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.markers.read import read_markers
from solver_backend.io.text_table import with_whole_decimals

LABELS = ("LASI", "RASI", "C7", "T10", "STRN")
POINTS = np.array([[1000.0 * m + 100.5 * axis + 0.25 * frame for axis in range(3)] for frame in range(4) for m in
                   (-1, 1, 2, 3, -4)]).reshape(4, 5, 3)  # fmt: skip


def cells(frame: int, text: str = "{:.2f}") -> list[str]:
    return [text.format(value) for value in POINTS[frame].ravel()]


def trc(path: Path, rows: list[list[str]], separator: str = "\t") -> Path:
    head = [
        ["PathFileType", "4", "(X/Y/Z)", "a.trc"], ["DataRate", "NumFrames", "NumMarkers", "Units"],
        ["50", "4", "5", "mm"], ["Frame#", "Time", *(cell for label in LABELS for cell in (label, "", ""))], [""],
    ]  # fmt: skip
    lines = [separator.join(line) for line in (*head, *rows)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def numbered(text: str = "{:.2f}") -> list[list[str]]:
    return [[str(frame + 1), f"{frame / 50:.2f}", *cells(frame, text)] for frame in range(4)]


def positions(path: Path, **options: object) -> np.ndarray:
    found = read_markers(path, unit="mm", up_axis="z", **options).cloud
    assert found.labels == LABELS
    return 1e3 * found.positions


@pytest.mark.parametrize("word", ["#N/A", "#NV", "#DIV/0!", "#VALUE!", "#WERT!"])
def test_a_spreadsheets_error_is_a_missing_value(tmp_path, word):
    rows = numbered()
    rows[1][2:5] = [word] * 3
    found = positions(trc(tmp_path / "a.trc", rows))
    assert np.isnan(found[1, 0]).all() and np.isfinite(found).sum() == found.size - 3


@pytest.mark.parametrize("group", ["\u00a0", "\u202f", "'", "\u2019", " "])
def test_groups_of_thousands_and_a_printed_minus(tmp_path, group):
    rows = [[cell.replace(",", group).replace("-", "\u2212") for cell in row] for row in numbered("{:,.2f}")]
    np.testing.assert_allclose(positions(trc(tmp_path / "a.trc", rows)), POINTS, atol=1e-9)


def test_bars_between_cells(tmp_path):
    np.testing.assert_allclose(positions(trc(tmp_path / "a.trc", numbered(), "|")), POINTS)


def in_halves(rows: list[list[str]], missing: bool = True) -> list[list[str]]:
    """Return rows whose decimal commas are not quoted, so that they look like separators."""
    if missing:
        rows[2][-3:] = [""] * 3
    return [[cell.replace(".", ",") for cell in row] for row in rows]


def expected(missing: bool = True) -> np.ndarray:
    found = POINTS.copy()
    found[2, -1] = np.nan if missing else found[2, -1]
    return found


def test_decimal_commas_between_commas_are_put_together_in_trc(tmp_path):
    np.testing.assert_allclose(positions(trc(tmp_path / "a.trc", in_halves(numbered()), ",")), expected())


def test_and_where_the_header_is_shifted_by_its_own(tmp_path):
    path = trc(tmp_path / "a.trc", in_halves(numbered()), ",")
    path.write_text(path.read_text().replace("50,4,5,mm", "50,00,4,5,mm"))
    np.testing.assert_allclose(positions(path), expected())


@pytest.mark.parametrize("first", ["frame", "time"])
def test_and_in_a_table_of_points(tmp_path, first):
    rows = [row[:1] + row[2:] if first == "frame" else row[1:] for row in numbered()]
    heading = ",".join([first, *(f"{label}_{axis}" for label in LABELS for axis in "xyz")])
    path = tmp_path / "a.csv"
    path.write_text("\n".join([heading, *(",".join(row) for row in in_halves(rows))]))
    np.testing.assert_allclose(positions(path, fps=50), expected())


def test_and_in_a_long_table(tmp_path):
    rows = [[str(f), label, *cells(f)[3 * m : 3 * m + 3]] for f in range(4) for m, label in enumerate(LABELS)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["frame,marker,x,y,z", *(",".join(row) for row in in_halves(rows, missing=False))]))
    np.testing.assert_allclose(positions(path, fps=50), expected(missing=False))


@pytest.mark.parametrize("quotes", ["", '"'])
def test_and_in_nexus(tmp_path, quotes):
    rows = [[str(f + 1), "0", *cells(f)] for f in range(4)]
    rows = [[*row[:2], *(f"{quotes}{cell}{quotes}" if cell else "" for cell in row[2:])] for row in in_halves(rows)]
    names = ",".join(["", "", *(cell for label in LABELS for cell in (label, "", ""))])
    head = ["Trajectories", "50", names, ",".join(["Frame", "Sub Frame", *"XYZ" * 5]), ",".join(["", "", *["mm"] * 15])]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([*head, *(",".join(row) for row in rows)]))
    np.testing.assert_allclose(positions(path), expected())


@pytest.mark.parametrize(("separator", "ending"), [(";", "csv"), (",", "csv"), ("\t", "tsv")])
@pytest.mark.parametrize("timed", [True, False])
def test_and_in_qualisys(tmp_path, separator, ending, timed):
    names = ["Frame", "Time", *(f"{label} {axis}" for label in LABELS for axis in "XYZ")]
    head = [["NO_OF_FRAMES", "4"], ["NO_OF_MARKERS", "5"], ["FREQUENCY", "50"], ["DATA_INCLUDED", "3D"],
            ["MARKER_NAMES", *LABELS], *([names] if timed else [])]  # fmt: skip
    rows = in_halves([row if timed else row[2:] for row in numbered()])
    path = tmp_path / f"a.{ending}"
    path.write_text("\n".join(separator.join(row) for row in (*head, *rows)))
    np.testing.assert_allclose(positions(path), expected())


def test_what_cannot_be_put_together_is_refused_with_the_reason(tmp_path):
    rows = in_halves(numbered())
    rows[3][4] = "7"  # a whole number among decimals: which digits are whose is not known
    with pytest.raises(FileDamaged, match="Commas separate both cells and decimals"):
        read_markers(trc(tmp_path / "a.trc", rows, ","))


def test_whole_numbers_of_more_points_are_left_alone():
    rows = [["1", "2", "3", "4", "5", "6", "7"]]
    assert with_whole_decimals(rows, 6, 1, Path("a")) is rows
