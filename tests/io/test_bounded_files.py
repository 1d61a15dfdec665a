"""Files that are far too large, too deep or numbered by the clock are refused by name, at once."""

from __future__ import annotations

import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.io.calibration.programs import read_qualisys
from solver_backend.io.detections.column_table import is_table
from solver_backend.io.detections.json_documents import people_in_picture
from solver_backend.io.files import read_json, read_toml
from solver_backend.io.footage import read_video_header
from solver_backend.io.markers.point_table import begins_as_points
from solver_backend.io.motions.bvh import read_bvh
from solver_backend.io.recognition.frame_numbers import frame_numbers
from tests.support.trial_files import read_folders

BVH = "HIERARCHY\nROOT hips\n{\n OFFSET 0 0 0\n CHANNELS 3 Zrotation Xrotation Yrotation\n}\nMOTION\n"


def sparse(path: Path, size: int) -> Path:
    with path.open("wb") as stream:
        stream.truncate(size)
    return path


@pytest.mark.parametrize("read", [read_json, read_toml, read_qualisys, read_bvh])
def test_ten_gigabytes_are_refused_by_their_size(tmp_path: Path, read: object) -> None:
    with pytest.raises(FileDamaged, match=r"has 10,000\.0 MB, but files of this kind have at most .*big"):
        read(sparse(tmp_path / "big", 10_000_000_000))  # type: ignore[operator]


@pytest.mark.parametrize("content", [b"", b"\0\0\0\x08free" * 100_000, struct.pack(">I4sQ", 1, b"mdat", 2**63 + 9),
                                     struct.pack(">I4s", 0, b"moov"), struct.pack(">I4s", 9, b"moov")])  # fmt: skip
def test_sparse_and_forged_videos_have_no_header(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with path.open("rb+") as stream:
        stream.truncate(10_000_000_000)
    start = time.monotonic()
    assert read_video_header(path) is None
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize(
    "text",
    [
        ".".join(["a"] * 500_000) + " = 1", "[" + ".".join(["1"] * 500_000) + "]",
        "x = {" + ".".join(['"\\""'] * 200_000) + " = 1}", "a = " + "[" * 100_000, "a = " + "{a = " * 100_000,
    ],
)  # fmt: skip
def test_deep_toml_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.toml").write_text(text)
    start = time.monotonic()
    with pytest.raises(FileDamaged, match="not TOML"):
        read_toml(tmp_path / "a.toml")
    assert time.monotonic() - start < 5.0


def test_dotted_keys_and_numbers_of_real_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('a.b."c" = [' + "1.5, " * 100 + "]\n[x.y.z]\nname = 'v1.2.3'\n")
    found = read_toml(tmp_path / "a.toml")
    assert len(found["a"]["b"]["c"]) == 100
    assert found["x"]["y"]["z"]["name"] == "v1.2.3"


def test_people_of_a_million_keypoints_are_refused_before_they_are_stored(tmp_path: Path) -> None:
    folders = {}
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        folders[name] = tmp_path / name
        for frame in (0, 999):
            people = [{"pose_keypoints_2d": [1.0] * 900_000 if frame else []}]
            (tmp_path / name / f"{frame}.json").write_text(json.dumps({"people": people}))
    with pytest.raises(KeypointCountMismatch, match="300000 keypoints"):
        read_folders(folders)


def test_numbers_that_no_float_holds_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": [10**400, 0, 1]}]}))
    with pytest.raises(FileDamaged, match="not numbers"):
        people_in_picture(read_json(tmp_path / "a.json"), "a.json")


@pytest.mark.parametrize(
    ("stems", "message"),
    [
        (["0", "33333", "66666"], "run from 0 to 66666 in steps of 33333, as times do"),
        (["1700000000000", "1700000000033", "1700000000066"], "in steps of 33, as times do"),
        (["1", "900000000"], "from 1 to 900000000 over 900,000,000 frames"),
        (["1", "2", "3", "90000"], "over 90,000 frames"),
        ([f"{10**22 + n}" for n in range(3)], "contains no frame number of up to 18 digits"),
    ],
)
def test_numbers_that_count_no_frames_are_named(stems: list[str], message: str) -> None:
    with pytest.raises(FileDamaged, match=message):
        frame_numbers(stems, where="folder")


def test_long_serial_numbers_beside_the_frame_number_do_not_matter() -> None:
    stems = [f"{10**22}_{n:06d}_{10**25}" for n in range(3)]
    np.testing.assert_array_equal(frame_numbers(stems, where=""), [0, 1, 2])
    np.testing.assert_array_equal(frame_numbers(["5", "900"], where=""), [5, 900])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BVH + "Frames: 9999999999\nFrame Time: 0.1\n0 0 0", "9999999999 frames"),
        (BVH + "Frames: " + "9" * 4300 + "\nFrame Time: 0.1\n0 0 0", "MOTION states 9999"),
        (BVH + "Frames: " + "9" * 5000 + "\nFrame Time: 0.1\n0 0 0", "MOTION is truncated"),
        (BVH + "Frames: 1\nFrame Time: inf\n0 0 0", "1 frames of inf s"),
        (
            BVH.replace("CHANNELS 3 Zrotation Xrotation Yrotation", "") + "Frames: 9000\nFrame Time: 1\n",
            "cannot be read at once",
        ),
        (BVH.replace("3 Zro", "4 Zrotation Zro") + "Frames: 5\nFrame Time: 1\n0 0 0", "5 frames of 4 channels"),
        (BVH.replace("3 Zro", "7" + " Zrotation" * 4 + " Zro") + "Frames: 1\nFrame Time: 1\n0", "not understood"),
        (
            "HIERARCHY\nROOT a\n{\n" + "JOINT b\n{\n}\n" * 2000 + "}\nMOTION\n",
            "2,001 joints, but at most 1000 are supported",
        ),
        ("HIERARCHY" + "{" * 5_000_001 + "MOTION\n", "characters, too many for a skeleton"),
    ],
)
def test_forged_bvh_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.bvh").write_text(text)
    with pytest.raises(FileDamaged, match=message):
        read_bvh(tmp_path / "a.bvh")


def test_long_motions_are_read_a_part_at_a_time(tmp_path: Path) -> None:
    numbers = np.round(np.random.default_rng(0).uniform(-180, 180, (40_000, 3)), 6)
    lines = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in numbers)
    assert len(lines) > 1 << 20
    (tmp_path / "a.bvh").write_text(BVH + f"Frames: 40000\nFrame Time: 0.01\n{lines}\n")
    clip = read_bvh(tmp_path / "a.bvh")
    assert clip.rotations.shape == (40_000, 1, 3, 3)


@pytest.mark.parametrize("heading", ["[" * 60_000, "_" * 60_000, "a_" * 30_000])
def test_a_heading_without_an_end_is_none_at_once(tmp_path: Path, heading: str) -> None:
    path, text = tmp_path / "a.csv", f"{heading}!,{heading}!\n1,2\n"
    path.write_text(text)
    begun = time.process_time()
    assert not is_table(path) and not begins_as_points(text)
    assert time.process_time() - begun < 1.0
