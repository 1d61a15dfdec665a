"""Text files: damaged ones are named."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.io.files import read_json, read_text, read_toml


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
