"""Files are written whole or not at all, and damaged ones are named."""

from __future__ import annotations

import contextlib
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, OutputExists, OutputNotWritable
from solver_backend.exchange.npz import read_npz, write_npz
from solver_backend.exchange.outputs import atomic_files, atomic_output, check_output, write_text


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def write_half(path: Path, failure: BaseException) -> None:
    with atomic_output(path, overwrite=True) as temporary:
        temporary.write_bytes(b"half")
        raise failure


def test_npz_round_trip_keeps_dtypes_values_and_names(tmp_path: Path) -> None:
    arrays = {
        "file": np.arange(3, dtype=np.int16), "text": np.array("ä"), "empty": np.zeros((0, 2), np.float32),
        "nan": np.array([np.nan, np.inf, -0.0]), "flags": np.array([True, False]),
    }  # fmt: skip
    back = read_npz(write_npz(tmp_path / "x.npz", arrays))
    assert set(back) == set(arrays)
    for key, value in arrays.items():
        assert back[key].dtype == value.dtype
        np.testing.assert_array_equal(back[key], value)
    assert names(tmp_path) == ["x.npz"]


def test_existing_output_is_kept_unless_asked(tmp_path: Path) -> None:
    path = write_text(tmp_path / "x.txt", "old")
    with pytest.raises(OutputExists, match=r"already exist.*x\.txt.*another name"):
        write_text(path, "new")
    assert path.read_text() == "old"
    write_text(path, "new", overwrite=True)
    assert path.read_text() == "new"
    assert names(tmp_path) == ["x.txt"]


@pytest.mark.parametrize("failure", [RuntimeError("stop"), KeyboardInterrupt()])
def test_a_failure_while_writing_leaves_nothing(tmp_path: Path, failure: BaseException) -> None:
    with pytest.raises(type(failure)):
        write_half(tmp_path / "x.bin", failure)
    assert names(tmp_path) == []


def test_a_failure_while_overwriting_keeps_the_old_file(tmp_path: Path) -> None:
    path = write_text(tmp_path / "x.txt", "old")
    with pytest.raises(RuntimeError):
        write_half(path, RuntimeError("stop"))
    assert path.read_text() == "old"
    assert names(tmp_path) == ["x.txt"]


def test_full_disk_is_named_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputNotWritable, match=r"No space left on device.*enough free space"):
        write_npz(tmp_path / "x.npz", {"a": np.zeros(3)})
    assert names(tmp_path) == []


def test_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(self: Path, *args: object, **kwargs: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "touch", denied)
    with pytest.raises(OutputNotWritable, match=r"Permission denied.*x\.npz.*writable folder"):
        write_npz(tmp_path / "x.npz", {"a": np.zeros(3)})
    assert names(tmp_path) == []


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission_for_real(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(OutputNotWritable, match="Permission denied"):
        check_output(tmp_path / "x.npz")
    tmp_path.chmod(0o700)


def test_a_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("I am a file")
    with pytest.raises(OutputNotWritable, match=r"cannot be written"):
        write_npz(tmp_path / "out" / "x.npz", {"a": np.zeros(3)})
    assert names(tmp_path) == ["out"]


def test_a_folder_in_place_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "x.npz").mkdir()
    with pytest.raises(OutputExists):
        check_output(tmp_path / "x.npz")
    with pytest.raises(OutputNotWritable, match="is a folder"):
        check_output(tmp_path / "x.npz", overwrite=True)


@pytest.mark.skipif(os.name == "nt", reason="Windows names the fault in another way")
def test_a_folder_with_too_long_a_name(tmp_path: Path) -> None:
    with pytest.raises(OutputNotWritable, match="too long"):
        write_text(tmp_path / ("a" * 300) / "x.txt", "x")


def test_missing_folders_are_made(tmp_path: Path) -> None:
    write_text(tmp_path / "a" / "b" / "x.txt", "x")
    assert names(tmp_path / "a" / "b") == ["x.txt"]


def test_object_arrays_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'bad' is an object array"):
        write_npz(tmp_path / "x.npz", {"bad": np.array([{}])})
    assert names(tmp_path) == []


def test_pickles_inside_are_never_run(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple:
            return (Path.touch, (tmp_path / "ran",))

    np.savez(tmp_path / "x.npz", good=np.arange(2), bad=np.array([Bomb()], dtype=object))
    assert list(read_npz(tmp_path / "x.npz")) == ["good"]
    (tmp_path / "y.npz").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(FileDamaged, match=r"is not an \.npz"):
        read_npz(tmp_path / "y.npz")
    assert not (tmp_path / "ran").exists()


def test_every_truncation_of_an_npz_is_named(tmp_path: Path) -> None:
    data = write_npz(
        tmp_path / "x.npz", {"a": np.random.default_rng(0).normal(size=200), "b": np.array("t")}
    ).read_bytes()
    for size in [*range(0, len(data) - 1, 97), len(data) - 1]:
        (tmp_path / "cut.npz").write_bytes(data[:size])
        with pytest.raises(FileDamaged, match=r"truncated.*cut\.npz"):
            read_npz(tmp_path / "cut.npz")


def test_a_flipped_byte_is_named_or_harmless(tmp_path: Path) -> None:
    data = write_npz(tmp_path / "x.npz", {"a": np.random.default_rng(0).normal(size=200)}).read_bytes()
    for index in range(0, len(data), 53):
        (tmp_path / "bad.npz").write_bytes(data[:index] + bytes([data[index] ^ 0xFF]) + data[index + 1 :])
        with contextlib.suppress(FileDamaged):
            read_npz(tmp_path / "bad.npz")


def test_bare_array_is_not_an_archive(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.zeros(3))
    (tmp_path / "x.npy").rename(tmp_path / "x.npz")
    with pytest.raises(FileDamaged, match="no zip archive"):
        read_npz(tmp_path / "x.npz")


@pytest.mark.parametrize("length", [230, 254, 255])
def test_names_as_long_as_the_system_allows(length: int, tmp_path: Path) -> None:
    paths = [tmp_path / (letter * (length - 5) + ".json") for letter in "ab"]
    with atomic_files(paths) as unfinished:
        assert [path.suffix for path in unfinished] == [".json", ".json"]
        for path in unfinished:
            path.write_text(path.name)
    assert names(tmp_path) == sorted(path.name for path in paths)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileMissing, match=r"no such file.*nowhere"):
        read_npz(tmp_path / "nowhere")
    for place in (tmp_path, Path(os.devnull)):
        with pytest.raises(FileMissing, match="The path is a folder, a pipe or a device"):
            read_npz(place)
