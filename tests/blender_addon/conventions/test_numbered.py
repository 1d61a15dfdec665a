"""What is numbered takes a number above all that are there, whatever they end in."""

from __future__ import annotations

from blender_addon.conventions.naming import next_path


def test_numbers_go_on_after_the_highest_whatever_bears_it(tmp_path):
    assert next_path(tmp_path, "live", ".c3d").name == "live_01.c3d"
    (tmp_path / "live_01.c3d").touch()
    (tmp_path / "live_03").mkdir()
    (tmp_path / "live_x.c3d").touch()
    (tmp_path / "alive_09.c3d").touch()
    assert next_path(tmp_path, "live", ".c3d").name == "live_04.c3d"
    (tmp_path / "live_112.toml").touch()
    assert next_path(tmp_path, "live").name == "live_113"
