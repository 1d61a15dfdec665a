"""Text files and arrays: damaged ones are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged, FileMissing
from solver_backend.io.calibration.camera_values import numbers
from solver_backend.io.files import load_array, read_json, read_text, read_toml
from solver_backend.io.text_table import rate_of


@pytest.mark.parametrize("read", [read_text, read_json, read_toml])
def test_missing_file(tmp_path: Path, read: object) -> None:
    with pytest.raises(FileMissing, match=r"no such file.*nowhere"):
        read(tmp_path / "nowhere")  # type: ignore[operator]


@pytest.mark.parametrize(
    ("text", "read"), [('{"a": [1, 2', read_json), ("hello", read_json), ("a = [1,", read_toml), ("", read_json)]
)
def test_truncated_text(tmp_path: Path, text: str, read: object) -> None:
    (tmp_path / "x").write_text(text)
    with pytest.raises(FileDamaged, match=r"truncated or is not (JSON|TOML)"):
        read(tmp_path / "x")  # type: ignore[operator]


def test_text_with_mark_and_old_encodings(tmp_path: Path) -> None:
    (tmp_path / "mark").write_bytes(b'\xef\xbb\xbf{"a": 1}')
    assert read_json(tmp_path / "mark") == {"a": 1}
    (tmp_path / "latin").write_bytes(b"K\xfcche")
    assert read_text(tmp_path / "latin") == "Küche"


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (9223372036854775807, 9, 3), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (100000000, 40, 3), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-5, 40, 3), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (3L, 4L), }",
        "{'descr': '<f8',",
        "[" * 1000,
    ],
)
def test_an_array_that_claims_more_than_it_holds_is_named(header: str, tmp_path: Path) -> None:
    text = header.encode() + b"\n"
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(96))
    with pytest.raises(FileDamaged, match="not a NumPy array"):
        load_array(tmp_path / "a.npy")


@pytest.mark.parametrize("order", ["C", "F"])
def test_an_array_is_what_numpy_wrote(order: str, tmp_path: Path) -> None:
    array = np.asarray(np.arange(24.0).reshape(2, 3, 4), order=order)
    np.save(tmp_path / "a.npy", array)
    np.testing.assert_array_equal(load_array(tmp_path / "a.npy"), array)
    np.save(tmp_path / "a.npy", np.zeros((0, 3)))
    assert load_array(tmp_path / "a.npy").shape == (0, 3)


def test_times_without_a_possible_step_give_no_rate() -> None:
    assert rate_of(np.array([0.0, 5e-324, 1e-323])) is None
    assert rate_of(np.arange(5) / 240.0) == 240.0


def test_complex_numbers_are_no_camera() -> None:
    with pytest.raises(CalibrationInvalid, match="a value that is not a number"):
        numbers(np.eye(3) + 1j, "a camera")
