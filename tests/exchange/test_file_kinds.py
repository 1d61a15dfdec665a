"""A file of another kind of ours is named for what it is, with the verbs that read it."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.exchange import marker_formats
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.verbs import VERBS
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import read_motion, write_motion
from tests.support.scenes import small_capture, small_motion


def test_our_own_motion_is_no_clip_to_convert(tmp_path: Path) -> None:
    path = write_motion(tmp_path / "walk.npz", small_motion(2))
    with pytest.raises(FileDamaged, match="is a Manifold MoCap motion, but a clip of another skeleton is") as caught:
        read_foreign_clip(path)
    assert "bake" in caught.value.hint and "manifold" not in str(caught.value)


def test_a_capture_is_no_motion(tmp_path: Path) -> None:
    write_capture(tmp_path / "a.npz", small_capture(2))
    with pytest.raises(FileDamaged, match="is a capture, but a Manifold MoCap motion is expected"):
        read_motion(tmp_path / "a.npz")


@pytest.mark.parametrize("found", marker_formats._KINDS)
def test_hints_name_verbs(found: str) -> None:
    error = marker_formats.other_kind(found, "manifold_mocap_capture", "a.npz")
    assert any(verb in error.hint.lower() for verb in (*VERBS, "blender ")), error.hint
