"""TRC files of several programs, with the faults that real ones have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.camera_systems import read_trc
from solver_backend.io.markers.read import read_markers
from solver_backend.io.markers.source import MarkerTake
from solver_backend.io.text_table import decimal_comma
from tests.support.marker_reading import missing, stated, taken
from tests.support.words import codes, facts, words

KEYS = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
LABELS = "Frame#\tTime\tC7\t\t\tL.Toe\t\t"
AXES = "\t\tX1\tY1\tZ1\tX2\tY2\tZ2"


def read(path: Path, **options: object) -> MarkerTake:
    return taken(read_trc, path, **options)


def write(
    path: Path,
    rows: Sequence[str],
    labels: str = LABELS,
    values: str = "100\t100\t{}\t2\tmm\t100\t1\t{}",
    *,
    ending: str = "\r\n",
    blank: str | None = "",
) -> Path:
    head = ["PathFileType\t4\t(X/Y/Z)\tC:\\a b\\take.trc", KEYS, values.format(len(rows), len(rows)), labels, AXES]
    lines = [*head, *([] if blank is None else [blank]), *rows]
    path.write_bytes((ending.join(lines) + ending).encode())
    return path


def rows(frames: int = 4, cells: str = "100.5\t1500.0\t-20\t90\t30\t1.5E+01") -> list[str]:
    return [f"{i}\t{(i - 1) / 100:.3f}\t{cells}" for i in range(1, frames + 1)]


EXPECTED = np.array([[0.1005, 0.02, 1.5], [0.09, -0.015, 0.03]])


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("blank", ["", "\t\t\t", None])
def test_y_up_by_the_body(tmp_path: Path, ending: str, blank: str | None) -> None:
    found = read(write(tmp_path / "t.trc", rows(), ending=ending, blank=blank))
    np.testing.assert_allclose(found.cloud.positions, np.tile(EXPECTED, (4, 1, 1)), atol=1e-12)
    assert (found.cloud.labels, found.cloud.fps) == (("C7", "L.Toe"), 100.0)
    assert (stated(found).format, stated(found).unit, stated(found).up_axis) == ("TRC", "mm", "y")
    assert {"unit_read", "up_axis_read"} <= set(codes(found.notes))
    assert found.problems == ()


def test_z_up_by_the_body(tmp_path: Path) -> None:
    found = read(write(tmp_path / "t.trc", rows(cells="100\t20\t1500\t90\t10\t30")))
    np.testing.assert_allclose(found.cloud.positions[0], [[0.1, 0.02, 1.5], [0.09, 0.01, 0.03]])
    assert stated(found).up_axis == "z" and "up_axis_read" in codes(found.notes)


@pytest.mark.parametrize(
    "cells",
    [
        "100\t1500\t20\t\t\t", "100\t1500\t20", "100\t1500\t20\tNaN\tNaN\tNAN", "100\t1500\t20\t nan\t   NaN\tNan ",
        "100\t1500\t20\t0\t0.00\t-0", "100\t1500\t20\t1\t\t2", "100\t1500\t20\t-1.#IND\t1.#QNAN\t1.#IND",
    ],
)  # fmt: skip
def test_missing_markers(tmp_path: Path, cells: str) -> None:
    lines = rows()
    lines[2] = f"3\t0.02\t{cells}"
    found = read(write(tmp_path / "t.trc", lines))
    assert np.isnan(found.cloud.positions[2, 1]).all()
    assert np.isnan(found.cloud.positions).sum() == 3
    assert missing(found) == (0, 1)


def test_wrong_counts_are_said(tmp_path: Path) -> None:
    found = read(write(tmp_path / "t.trc", rows(), values="100\t100\t9\t7\tmm\t100\t1\t9"))
    assert found.cloud.positions.shape == (4, 2, 3)
    assert facts(found.problems) == (
        "The file states 7 markers but contains 2.",
        "The file states 9 frames but contains 4.",
    )


def test_more_columns_than_labels_and_less(tmp_path: Path) -> None:
    more = read(write(tmp_path / "m.trc", rows(cells="100\t1500\t20\t90\t30\t10\t5\t6\t7")))
    assert more.cloud.labels == ("C7", "L.Toe", "*3")
    assert more.unlabelled == ("*3",)
    less = read(write(tmp_path / "l.trc", rows(cells="100\t1500\t20")))
    assert missing(less) == (0, 4)


def test_unlabelled_rows_of_unequal_length(tmp_path: Path) -> None:
    lines = ["1\t0\t1\t2\t3\t4\t5\t6", "2\t0.01", "3\t0.02\t1\t2\t3"]
    found = taken(
        read_trc, write(tmp_path / "t.trc", lines, labels="Frame#\tTime\t", values="100\t100\t3\t0\tm\t100\t1\t3")
    )
    assert found.cloud.labels is None
    assert missing(found) == (1, 2)
    assert any("2 of 2 points have no label" in note for note in words(found.notes))


def test_labels_between_other_numbers_of_tabs(tmp_path: Path) -> None:
    for labels in ("Frame#\tTime\t\tC7\t\tL.Toe\t", "Frame#\tTime\tC7\tL.Toe", "Frame#\tTime\t C7 \t\t\tL.Toe"):
        assert read(write(tmp_path / "t.trc", rows(), labels=labels)).cloud.labels == ("C7", "L.Toe")
    named = read(write(tmp_path / "t.trc", rows(), labels="Frame#\tTime\t\t\t\tL.Toe"))
    assert named.cloud.labels == ("*1", "L.Toe")


def test_doubled_tabs_between_numbers(tmp_path: Path) -> None:
    lines = [row.replace("\t", "\t\t") for row in rows()]
    found = read(write(tmp_path / "t.trc", lines, values="100\t\t100\t\t4\t\t2\t\tmm\t100\t1\t4"))
    np.testing.assert_allclose(found.cloud.positions[0], EXPECTED, atol=1e-12)
    assert not found.problems and "as stated in the file" in " ".join(words(found.notes))


def test_doubled_tabs_in_both_lines_of_the_header(tmp_path: Path) -> None:
    path = write(tmp_path / "t.trc", rows(), values="100\t\t100\t\t4\t\t7\t\tm\t\t100\t\t1\t\t4")
    path.write_text(path.read_text().replace(KEYS, KEYS.replace("\t", "\t\t")))
    source = read_trc(path)
    assert source.unit == "m" and facts(source.problems) == ("The file states 7 markers but contains 2.",)


def test_spaces_instead_of_tabs(tmp_path: Path) -> None:
    lines = [row.replace("\t", "  ") for row in rows()]
    found = read(write(tmp_path / "t.trc", lines, labels="Frame# Time C7 LTOE"))
    np.testing.assert_allclose(found.cloud.positions[0], EXPECTED, atol=1e-12)


def test_rates(tmp_path: Path) -> None:
    none = read(write(tmp_path / "t.trc", rows(), values="\t\t4\t2\tmm\t\t1\t4"), unit="mm")
    assert none.cloud.fps == pytest.approx(100.0)
    zero = read(write(tmp_path / "t.trc", rows(), values="0\t0\t4\t2\tmm\t0\t1\t4"))
    assert zero.cloud.fps == pytest.approx(100.0)
    other = read(write(tmp_path / "t.trc", rows(), values="250\t250\t4\t2\tmm\t250\t1\t4"))
    assert other.cloud.fps == pytest.approx(100.0)  # thinned out: the header stayed
    assert [item.values["others"] for item in other.problems] == ["the header states 250 and the times 100"]
    milliseconds = [f"{i}\t{10 * i}\t" + row.split("\t", 2)[2] for i, row in enumerate(rows())]
    slow = read(write(tmp_path / "t.trc", milliseconds, values="250\t250\t4\t2\tmm\t250\t1\t4"))
    assert slow.cloud.fps == 250.0
    assert [item.values["others"] for item in slow.problems] == ["the header states 250 and the times 0.1"]
    with pytest.raises(FileDamaged, match="states a frame rate of 0"):
        read(write(tmp_path / "t.trc", rows(1), values="0\t0\t1\t2\tmm\t0\t1\t1"))


def test_frame_numbers_that_jump(tmp_path: Path) -> None:
    lines = rows(9)
    del lines[1]
    found = read(write(tmp_path / "t.trc", lines))
    assert facts(found.problems) == (
        "Frame numbers jump from 1 to 3 (number of jumps: 1). The frames are treated as consecutive.",
    )


def test_damage(tmp_path: Path) -> None:
    path = tmp_path / "t.trc"
    for text in ("", "PathFileType\t4\n", "\0\1\2", "a,b,c\n1,2,3\n"):
        path.write_text(text)
        with pytest.raises(FileDamaged, match="is truncated or is not TRC"):
            read(path)
    with pytest.raises(FileDamaged, match=r"'12,5' is not a number \(.*line 8\)"):
        read(write(path, rows()[:1] + ["2\t0.01\t12,5\t1\t1"]))
    with pytest.raises(NoDetections, match="contains no frames"):
        read(write(path, []))
    with pytest.raises(NoDetections, match="contains no markers"):
        read(write(path, ["1\t0", "2\t0.01"], labels="Frame#\tTime"))
    with pytest.raises(FileDamaged, match="not a table"):
        read(write(path, ["1\t0" + "\t1" * 5000, *(f"{i}\t0" for i in range(2, 3000))]))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "frames", "markers", "fps", "unit", "up"),
    [
        ("opensim/constraintTest.trc", 2105, 44, 200.0, "mm", "y"),
        ("opensim/dataWithBlanksForMissingMarkers.trc", 464, 40, 250.0, "mm", "z"),
        ("opensim/dataWithEformat.trc", 5, 14, 119.88012, "m", "y"),
        ("opensim/dataWithNaNsOfDifferentCases.trc", 5, 14, 250.0, "mm", "y"),
        ("opensim/dataWithNaNsWithSpaces.trc", 427, 42, 100.0, "mm", "y"),
        ("opensim/exampleFormat.trc", 5, 3, 100.0, "m", "y"),
        ("opensim/std_walking2_markers.trc", 126, 44, pytest.approx(25.0), "mm", "z"),
        ("btkdata/Input/TRCSamples/MOTEK/T.trc", 89, 41, 30.0, "mm", "y"),
        ("btkdata/Input/TRCSamples/Knee.trc", 200, 71, 200.0, "mm", "y"),
        ("nimble/Subject4/MarkerData/walking1.trc", 131, 51, 100.0, "m", "y"),
    ],
)
def test_real_files(shared_data: Path, name: str, frames: int, markers: int, fps: float, unit: str, up: str) -> None:
    found = read(shared_data / "markers" / name)
    assert found.cloud.positions.shape == (frames, markers, 3)
    assert (found.cloud.fps, stated(found).unit, stated(found).up_axis) == (fps, unit, up)
    assert found.cloud.labels is not None
    assert len(found.unlabelled) == sum(label.startswith("*Unnamed_") for label in found.cloud.labels)


@pytest.mark.shared
def test_every_real_file_is_read_or_refused_by_name(shared_data: Path) -> None:
    files = sorted((shared_data / "markers").rglob("*.trc"))
    assert len(files) >= 29
    refused = []
    for path in files:
        try:
            read(path)
        except FileDamaged:
            refused.append(path.name)
    assert refused == ["Empty.trc", "Truncated.trc"]


@pytest.mark.shared
def test_the_same_trial_as_c3d(shared_data: Path) -> None:
    folder = shared_data / "markers/btkdata/Input"
    text = read(folder / "TRCSamples/Res16bits.trc")
    binary = taken(read_c3d, folder / "C3DSamples/others/Res16bits.c3d")
    np.testing.assert_allclose(text.cloud.positions, binary.cloud.positions, atol=2e-8)
    assert text.cloud.fps == binary.cloud.fps


@pytest.mark.parametrize(("separator", "comma"), [(",", False), (";", True), ("\t", True), (",", True)])
def test_a_file_that_a_spreadsheet_saved(tmp_path: Path, separator: str, comma: bool) -> None:
    rows = [
        ["PathFileType", "4", "(X/Y/Z)", "a.trc"], ["DataRate", "NumFrames", "NumMarkers", "Units"],
        ["50", "2", "2", "mm"], ["Frame#", "Time", "LASI", "", "", "RASI"],
        ["", "", "X1", "Y1", "Z1", "X2", "Y2", "Z2"],
        ["1", "0.00", "10.5", "900.25", "3.5", "-10.5", "901", "4"], ["2", "0.02", "11.5", "900", "3", "-11", "", ""],
    ]  # fmt: skip
    cells = [[cell.replace(".", ",") if comma and row > 4 else cell for cell in line] for row, line in enumerate(rows)]
    quoted = [[f'"{cell}"' if separator in cell else cell for cell in line] for line in cells]
    path = tmp_path / "a.trc"
    path.write_text("\n".join(separator.join(line) for line in quoted))
    take = read(path, unit="mm", up_axis="z")
    assert take.cloud.labels == ("LASI", "RASI") and take.cloud.fps == 50
    np.testing.assert_allclose(take.cloud.positions[0], [[0.0105, 0.90025, 0.0035], [-0.0105, 0.901, 0.004]])


@pytest.mark.parametrize(("ending", "encoding"), [("trc", "utf-16"), ("csv", "utf-8"), ("txt", "utf-16-le")])
def test_as_a_spreadsheet_names_and_encodes_it(tmp_path: Path, ending: str, encoding: str) -> None:
    """Excel's Unicode text is UTF-16, quotes labels between tabs, and groups thousands."""
    cells = "1,779.458\t-2,000.5\t900.25\t10.5\t-20\t1.5E+01"
    text = write(tmp_path / "a.trc", rows(cells=cells)).read_text()
    path, mark = tmp_path / f"b.{ending}", "\ufeff" if encoding == "utf-16-le" else ""
    path.write_bytes((mark + text.replace("C7", '"C7"')).encode(encoding))
    found = read_markers(path, unit="mm", up_axis="z").cloud
    assert found.labels is not None and found.labels[0] == "C7"
    np.testing.assert_allclose(found.positions[0], [[1.779458, -2.0005, 0.90025], [0.0105, -0.02, 0.015]])


@pytest.mark.parametrize(
    ("cells", "comma"),
    [(["1.779,5", "3"], True), (["1,5", "1.5"], False), (["1,779.5"], False), (["12"], False), (["1.5"], False)],
)
def test_which_of_commas_and_points_is_the_decimal_one(cells: list[str], comma: bool) -> None:
    assert decimal_comma(cells) is comma
