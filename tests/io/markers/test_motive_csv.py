"""CSV files of OptiTrack Motive of several versions, with rigid bodies, bones and what assets expect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.exchange.props import POSE_POINTS
from solver_backend.io.markers.camera_systems import begins_as_motive, read_motive_csv
from solver_backend.io.markers.source import MarkerTake
from tests.support.marker_reading import missing, stated, taken
from tests.support.words import words

MARKERS = ("Ann:HeadTop", "Ann:LToe")
FIRST = np.array([[0.1, 1.6, -0.2], [0.12, 0.03, 0.25]])
"""Metres, Y up."""


def read(path: Path, **options: object) -> MarkerTake:
    return taken(read_motive_csv, path, **options)


def columns(kind: str, name: str, quantity: str, axes: str, number: int = 0) -> list[tuple[str, ...]]:
    return [(kind, f'"{name}"', f'"{number:X}:00"', "", quantity, axis) for axis in axes]


def csv_text(
    groups: Sequence[tuple[str, ...]],
    rows: Sequence[str],
    *,
    version: str = "1.23",
    named_rows: bool = False,
    ids: bool = True,
    parents: bool = False,
    time_code: bool = False,
    rotation: str = "Quaternion",
    unit: str = "Meters",
    rates: str = "Capture Frame Rate,240.000000,Export Frame Rate,120.000000",
) -> str:
    head = (
        f'Format Version,{version},Take Name,"A, b",{rates},Capture Start Time,2024-01-01 10.00.00.000 AM,'
        f"Total Frames in Take,9,Total Exported Frames,{len(rows)},Rotation Type,{rotation},Length Units,{unit},"
        "Coordinate Space,Global"
    )
    before = ",," if time_code else ","
    kinds = {0: "Type", 1: "Name", 2: "ID", 3: "Parent"}
    wanted = [0, 1, *([2] if ids else []), *([3] if parents else []), 4]
    lines = [head, ""]
    for row in wanted:
        label = kinds.get(row, "") if named_rows else ""
        lines.append(f"{before}{label}," + ",".join(group[row] for group in groups))
    lines.append("Frame,Time (Seconds)," + ("TimeCode," if time_code else "") + ",".join(g[5] for g in groups))
    return "\n".join([*lines, *rows]) + "\n"


def measured() -> list[tuple[str, ...]]:
    return [column for i, name in enumerate(MARKERS) for column in columns("Marker", name, "Position", "XYZ", i)]


def rows(cells: str, frames: int = 3, middle: str = "") -> list[str]:
    return [f"{i},{i / 120:.6f},{middle}{cells}" for i in range(frames)]


def numbers(positions: np.ndarray) -> str:
    return ",".join(f"{value:.6f}" for value in positions.ravel())


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("version", ["1.2", "1.21", "1.22", "1.23", "1.25"])
def test_versions(tmp_path: Path, version: str) -> None:
    new = version == "1.25"
    text = csv_text(
        measured(), rows(numbers(FIRST)), version=version, named_rows=new, parents=new, ids=version != "1.2"
    )
    found = read(write(tmp_path / "take.csv", text))
    expected = FIRST[:, [0, 2, 1]] * [1, -1, 1]
    np.testing.assert_allclose(found.cloud.positions, np.tile(expected, (3, 1, 1)), atol=1e-9)
    assert (found.cloud.labels, found.cloud.fps, stated(found).format) == (MARKERS, 120.0, f"Motive CSV {version}")
    assert (stated(found).up_axis, stated(found).unit, found.subjects) == ("y", "m", ("Ann",))
    assert found.problems == ()


@pytest.mark.parametrize(("unit", "metres"), [("Millimeters", 1e-3), ("Centimeters", 1e-2), ("Inches", 0.0254)])
def test_units(tmp_path: Path, unit: str, metres: float) -> None:
    found = taken(
        read_motive_csv, write(tmp_path / "t.csv", csv_text(measured(), rows(numbers(FIRST / metres)), unit=unit))
    )
    np.testing.assert_allclose(found.cloud.positions[0], FIRST[:, [0, 2, 1]] * [1, -1, 1], atol=1e-7)


@pytest.mark.parametrize(
    ("rotation", "axes"), [("Quaternion", "XYZW"), ("XYZ", "XYZ"), ("ZYX", "XYZ"), ("Quaternion", "XYZ")]
)
def test_rigid_bodies_become_props_and_bones_are_left_out(tmp_path: Path, rotation: str, axes: str) -> None:
    body = [
        *columns("Rigid Body", "Wand", "Rotation", axes), *columns("Rigid Body", "Wand", "Position", "XYZ"),
        ("Rigid Body", '"Wand"', '"0"', "", "Mean Marker Error", ""),
        *columns("Rigid Body Marker", "Wand:Marker1", "Position", "XYZ"),
        ("Rigid Body Marker", '"Wand:Marker1"', '"0"', "", "Marker Quality", ""),
        *columns("Bone", "Ann:Hip", "Rotation", axes), *columns("Bone", "Ann:Hip", "Position", "XYZ"),
        *columns("Bone Marker", "Ann:HeadTop", "Position", "XYZ"),
    ]  # fmt: skip
    cells = ",".join(["9"] * len(body)) + "," + numbers(FIRST)
    if axes == "XYZW":  # a quarter turn about Motive's Y, which is our Z
        cells = (
            ",".join(["0", "0.70710678", "0", "0.70710678", "1", "2", "3", *["9"] * (len(body) - 7)])
            + ","
            + numbers(FIRST)
        )
    found = taken(
        read_motive_csv, write(tmp_path / "t.csv", csv_text([*body, *measured()], rows(cells), rotation=rotation))
    )
    assert found.cloud.labels == MARKERS
    np.testing.assert_allclose(found.cloud.positions[0, 0], [0.1, 0.2, 1.6], atol=1e-9)
    notes = " ".join(words(found.notes))
    assert "Ignored: 1 bones, because they are computed from the markers." in notes
    if axes == "XYZW":
        assert found.others is not None and found.others.labels == tuple(f"Wand:{point}" for point in POSE_POINTS)
        origin, *arms = found.others.positions[0]
        np.testing.assert_allclose(origin, [1, -3, 2], atol=1e-9)
        np.testing.assert_allclose(np.stack(arms) - origin, [[0, 0.1, 0], [0, 0, 0.1], [0.1, 0, 0]], atol=1e-6)
    else:
        assert found.others is None and "Ignored: rigid-body poses in Euler angles: Wand" in notes
    assert "Ignored: 2 expected marker positions, because measured ones exist." in notes


def test_expected_markers_where_there_are_no_others(tmp_path: Path) -> None:
    group = columns("Rigid Body Marker", "Wand:Marker1", "Position", "XYZ")
    found = taken(
        read_motive_csv, write(tmp_path / "t.csv", csv_text(group, ["0,0,0.1,0.5,0.3", "1,0.01,0.1,0.6,0.3"]))
    )
    assert found.cloud.labels == ("Wand:Marker1",)
    assert any("the markers are at the positions expected by their assets" in note for note in words(found.notes))


def test_blank_cells_and_a_time_code(tmp_path: Path) -> None:
    lines = rows(numbers(FIRST), middle="15:26:46:12.02,")
    lines[1] = "1,0.008333,15:26:46:13.02,,,," + numbers(FIRST[1])
    lines[2] = "2,0.016667,15:26:46:14.02,0.1,1.6,-0.2"
    found = taken(
        read_motive_csv, write(tmp_path / "t.csv", csv_text(measured(), lines, time_code=True, version="1.24"))
    )
    assert missing(found) == (1, 1)
    np.testing.assert_allclose(found.cloud.positions[1, 1], [0.12, -0.25, 0.03], atol=1e-9)


def test_unlabelled_markers(tmp_path: Path) -> None:
    group = [*columns("Marker", "Unlabeled 1189", "Position", "XYZ"), *measured()]
    found = read(write(tmp_path / "t.csv", csv_text(group, rows("1,1,1," + numbers(FIRST)))))
    assert (found.unlabelled, found.subjects) == (("Unlabeled 1189",), ("Ann",))


def test_rates(tmp_path: Path) -> None:
    for rates, fps in (("Capture Frame Rate,120.0", 120.0), ("Other,1", pytest.approx(120.0, rel=1e-3))):
        text = csv_text(measured(), rows(numbers(FIRST)), rates=rates)
        assert read(write(tmp_path / "t.csv", text)).cloud.fps == fps
    thinned = csv_text(measured(), rows(numbers(FIRST)), rates="Export Frame Rate,240.0")
    found = read(write(tmp_path / "t.csv", thinned))
    assert found.cloud.fps == 120.0
    assert [item.values["others"] for item in found.problems] == ["the header states 240 and the times 120"]
    untimed = [f"{i},,{numbers(FIRST)}" for i in range(3)]
    path = write(tmp_path / "t.csv", csv_text(measured(), untimed, rates="Capture Frame Rate,0"))
    with pytest.raises(FileDamaged, match="frame rate of 0"):
        read(path)


def test_no_markers_and_no_header(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    body = columns("Rigid Body", "Wand", "Position", "XYZ")
    with pytest.raises(NoDetections, match="no markers, only 1 rigid bodies and 0 bones.*'Markers' enabled"):
        read(write(path, csv_text(body, ["0,0,1,2,3"])))
    with pytest.raises(FileDamaged, match="does not start with 'Format Version'"):
        read(write(path, "0,0.0,1,2,3\n"))
    whole = csv_text(measured(), rows(numbers(FIRST)))
    with pytest.raises(FileDamaged, match="no row 'Frame, Time"):
        read(write(path, whole.split("Frame,Time")[0]))
    with pytest.raises(FileDamaged, match="no row of types"):
        read(write(path, whole.replace("Marker", "Thing")))
    with pytest.raises(FileDamaged, match="'abc' is not a number"):
        read(write(path, whole.replace("0.120000", "abc")))
    with pytest.raises(NoDetections, match="contains no frames"):
        read(write(path, csv_text(measured(), [])))
    with pytest.raises(NoDetections, match="contains no frames"):
        read(write(path, csv_text(measured(), [","])))
    (tmp_path / "one_line.csv").write_text("Format Version,1.23,X,Y,Z\n0,0.0,1,2,3\n")
    with pytest.raises(FileDamaged, match="no row of types"):
        read(tmp_path / "one_line.csv")


def test_words_of_another_language_and_a_first_line_that_was_cut(tmp_path: Path) -> None:
    whole = csv_text(measured(), rows(numbers(FIRST)), named_rows=True)
    found = taken(
        read_motive_csv, write(tmp_path / "t.csv", whole.replace("Frame,Time (Seconds)", "Bild,Zeit (Sekunden)"))
    )
    assert found.cloud.labels == MARKERS and found.cloud.fps == 120.0
    cut = write(tmp_path / "t.csv", whole.split("\n", 2)[2])
    assert begins_as_motive(cut.read_text()) and not begins_as_motive("type,name,x,y,z\n1,a,2,3,4\n")
    found = read(cut, unit="m")
    np.testing.assert_allclose(found.cloud.positions[0], FIRST[:, [0, 2, 1]] * [1, -1, 1], atol=1e-9)
    assert found.cloud.fps == 120.0 and stated(found).format == "Motive CSV"


def test_a_type_that_is_not_known_is_where_its_asset_expects_the_markers(tmp_path: Path) -> None:
    whole = csv_text(measured(), rows(numbers(FIRST))).replace(",Marker", ",Skeleton Marker")
    found = read(write(tmp_path / "t.csv", whole))
    assert found.cloud.labels == MARKERS
    assert any("the markers are at the positions expected by their assets" in note for note in words(found.notes))


@pytest.mark.parametrize("quotes", ["", '"'])
def test_a_spreadsheet_of_another_country_saved_it(tmp_path: Path, quotes: str) -> None:
    text = csv_text(measured(), rows(numbers(FIRST)), parents=True)
    lines = [line.replace('"A, b"', "A b").replace('"', "").split(",") for line in text.splitlines()]
    (tmp_path / "de.csv").write_text(
        "\n".join(";".join(f"{quotes}{cell.replace('.', ',')}{quotes}" for cell in line) for line in lines),
        encoding="utf-8",
    )
    (tmp_path / "en.csv").write_text(text, encoding="utf-8")
    found, expected = (read(tmp_path / name) for name in ("de.csv", "en.csv"))
    assert found.cloud.labels == expected.cloud.labels and found.cloud.fps == expected.cloud.fps == 120.0
    np.testing.assert_array_equal(found.cloud.positions, expected.cloud.positions)
