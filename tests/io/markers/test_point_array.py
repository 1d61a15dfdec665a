"""Arrays of 3D points with names beside them."""

import json

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, MocapError
from solver_backend.io.markers.read import read_markers


def stored(folder, points=17, frames=20):
    array = np.random.default_rng(0).normal(size=(frames, points, 3)) + [0, 0, 1.0]
    np.save(folder / "points.npy", array)
    return array


@pytest.mark.parametrize("name", ["points.txt", "points.json", "names.txt", "names.json"])
def test_names_stand_in_a_file_beside(tmp_path, name):
    stored(tmp_path)
    names = [f"point{i}" for i in range(17)]
    (tmp_path / name).write_text(json.dumps(names) if name.endswith("json") else "\n".join(names))
    take = read_markers(tmp_path / "points.npy", fps=50, unit="m", up_axis="z")
    assert take.cloud.labels == tuple(names) and take.cloud.fps == 50


def test_an_array_of_one_joint_set_needs_no_names(tmp_path):
    stored(tmp_path, points=33)
    labels = read_markers(tmp_path / "points.npy", fps=30, unit="m").cloud.labels
    assert labels is not None and "left_heel" in labels


@pytest.mark.parametrize("points", [12, 17])
def test_an_array_without_names_is_refused(tmp_path, points):
    stored(tmp_path, points)
    with pytest.raises(FileMissing, match=f"names of the array's {points} points"):
        read_markers(tmp_path / "points.npy", fps=30)


def test_another_number_of_names_is_named(tmp_path):
    stored(tmp_path)
    (tmp_path / "points.txt").write_text("nose\nneck\n")
    with pytest.raises(FileDamaged, match="2 names, but the array has 17 points"):
        read_markers(tmp_path / "points.npy", fps=30)


def test_an_array_states_no_frame_rate(tmp_path):
    stored(tmp_path, points=33)
    with pytest.raises(FileDamaged, match="not state a frame rate"):
        read_markers(tmp_path / "points.npy")


def test_pickled_and_truncated_arrays_are_damaged(tmp_path):
    np.save(tmp_path / "points.npy", np.array([{}, None], dtype=object), allow_pickle=True)
    with pytest.raises(FileDamaged, match="motion convert"):
        read_markers(tmp_path / "points.npy", fps=30)
    (tmp_path / "points.npy").write_bytes(b"\x93NUMPY")
    with pytest.raises(FileDamaged):
        read_markers(tmp_path / "points.npy", fps=30)


def test_an_archive_of_arrays_with_another_ending_is_named(tmp_path):
    np.savez(tmp_path / "points.npz", np.zeros((3, 17, 3)))
    (tmp_path / "points.npz").rename(tmp_path / "points.npy")
    with pytest.raises(FileDamaged, match=r"npz archive of arrays"):
        read_markers(tmp_path / "points.npy", fps=30)


def test_every_damage_to_the_header_of_an_array_is_named(tmp_path):
    stored(tmp_path)
    path = tmp_path / "points.npy"
    whole, rng, refused = path.read_bytes(), np.random.default_rng(1), 0
    for _ in range(300):
        damaged = bytearray(whole)
        at = int(rng.integers(128))
        other = rng.choice(list(b"0123456789(),'<f8TrueO"), int(rng.integers(3))).astype(np.uint8)
        damaged[at : at + int(rng.integers(3))] = other.tobytes()
        path.write_bytes(damaged)
        try:
            read_markers(path, fps=30)
        except MocapError:
            refused += 1
    assert refused > 100
