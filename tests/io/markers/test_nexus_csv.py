"""CSV and text files of Vicon Nexus and of its forerunners."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.io.markers.camera_systems import read_nexus_csv
from tests.support.marker_reading import missing, stated, taken
from tests.support.marker_texts import NEXUS_SECTIONS
from tests.support.words import facts, words

TRAJECTORIES = """Trajectories
100
,,Ann:C7,,,Ann:LTOE,,,Ann:LHipAngles,,
Frame,Sub Frame,X,Y,Z,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm,mm,mm,mm
101,0,100,-20,1500,90,15,30,1,2,3
102,0,101,-20,1500,,,,1,2,3
103,0,102,-20,1500,92,15,30

"""


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text", [TRAJECTORIES, "\n\n" + TRAJECTORIES, NEXUS_SECTIONS + TRAJECTORIES, TRAJECTORIES + NEXUS_SECTIONS]
)
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_trajectories(tmp_path: Path, text: str, ending: str) -> None:
    found = taken(read_nexus_csv, write(tmp_path / "t.csv", text.replace("\n", ending)))
    np.testing.assert_allclose(found.cloud.positions[0], [[0.1, -0.02, 1.5], [0.09, 0.015, 0.03]])
    assert (found.cloud.labels, found.cloud.fps) == (("Ann:C7", "Ann:LTOE"), 100.0)
    assert stated(found)[1:4] == (3, "mm", "z")
    assert (missing(found), found.subjects, words(found.problems)) == ((0, 1), ("Ann",), ())
    assert any(note.startswith("Ignored: 1 model outputs") for note in words(found.notes))
    if "Devices" in text:
        assert stated(found).analog_channels == ("Fx", "Fy", "Fz")


@pytest.mark.parametrize("delimiter", ["\t", ";"])
def test_other_delimiters_and_decimal_commas(tmp_path: Path, delimiter: str) -> None:
    text = TRAJECTORIES.replace(",", delimiter).replace("1500", "1500,5")
    found = taken(read_nexus_csv, write(tmp_path / "t.txt", text))
    np.testing.assert_allclose(found.cloud.positions[0, 0], [0.1, -0.02, 1.5005])


def test_workstation_export(tmp_path: Path) -> None:
    text = (
        'Title\nDescription:,""\n\nTRAJECTORIES\n120,Hz\n,C7,,,LTOE,,\nField #,X,Y,Z,X,Y,Z\n'
        "1,100,-20,1500,90,15,30\n2,100,-20,1501,90,15,30\n"
    )
    found = taken(read_nexus_csv, write(tmp_path / "t.csv", text))
    assert (found.cloud.labels, found.cloud.fps, len(found.cloud.positions)) == (("C7", "LTOE"), 120.0, 2)
    np.testing.assert_allclose(found.cloud.positions[1, 0], [0.1, -0.02, 1.501])


def test_a_label_less_than_columns(tmp_path: Path) -> None:
    found = taken(
        read_nexus_csv, write(tmp_path / "t.csv", TRAJECTORIES.replace(",,Ann:C7,,,Ann:LTOE,,,Ann:LHipAngles", ",,C7"))
    )
    assert found.cloud.labels == ("C7", "*2", "*3")


def test_what_is_none(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    with pytest.raises(NoDetections, match=r"no markers, only devices, events, model outputs.*'Trajectories' enabled"):
        taken(read_nexus_csv, write(path, NEXUS_SECTIONS))
    with pytest.raises(FileDamaged, match="not a Nexus export"):
        taken(read_nexus_csv, write(path, "a,b\n1,2\n"))
    for text in ("Trajectories\n", "Trajectories\n100\n,,C7,,\n"):
        with pytest.raises(FileDamaged, match="'Frame,Sub Frame,X,Y,Z' is expected"):
            taken(read_nexus_csv, write(path, text))
    with pytest.raises(FileDamaged, match="states a frame rate of 0"):
        taken(read_nexus_csv, write(path, TRAJECTORIES.replace("100\n", "0\n", 1)))
    with pytest.raises(FileDamaged, match="'x' is not a number.*line 7"):
        taken(read_nexus_csv, write(path, TRAJECTORIES.replace("102,0,101", "102,0,x")))
    with pytest.raises(NoDetections, match="contains no frames"):
        taken(read_nexus_csv, write(path, TRAJECTORIES.split("101,0")[0]))


@pytest.mark.shared
def test_a_real_file(shared_data: Path) -> None:
    found = taken(read_nexus_csv, shared_data / "markers/pycgm/ROM/Sample_Static.csv")
    assert (len(found.cloud.positions), found.cloud.fps, stated(found).up_axis) == (275, 100.0, "z")
    assert found.cloud.positions.shape == (275, 115, 3)
    assert found.cloud.labels is not None and found.cloud.labels[:2] == ("LFHD", "RFHD")


def test_sections_follow_each_other_without_an_empty_line_and_several_hold_trajectories(tmp_path: Path) -> None:
    block = TRAJECTORIES.strip() + "\n"
    text = (
        NEXUS_SECTIONS.replace("\n\n", "\n").strip()
        + "\n"
        + block
        + block.replace("Ann", "Bob")
        + "Model Outputs\n100\n"
    )
    found = taken(read_nexus_csv, write(tmp_path / "t.csv", text))
    assert found.cloud.labels == ("Ann:C7", "Ann:LTOE", "Bob:C7", "Bob:LTOE") and len(found.cloud.positions) == 3
    np.testing.assert_array_equal(found.cloud.positions[:, :2], found.cloud.positions[:, 2:])
    shorter = block + block.replace("103,0,102,-20,1500,92,15,30\n", "")
    found = taken(read_nexus_csv, write(tmp_path / "t.csv", shorter))
    assert facts(found.problems) == ("Ignored: 1 trajectory blocks that cover different frames.",)
    odd = block.replace("103,0,102,", "1e300,0,102,")
    assert taken(read_nexus_csv, write(tmp_path / "t.csv", odd)).cloud.positions.shape == (3, 2, 3)
    assert taken(read_nexus_csv, write(tmp_path / "t.csv", odd + odd)).cloud.positions.shape == (3, 4, 3)
