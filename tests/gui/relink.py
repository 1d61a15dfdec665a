"""A capture that was moved in the file manager: named in the panel, and linked again by a click.

``python -m tests.gui --script relink.py``.
"""

from __future__ import annotations

import shutil
from typing import Any

import bpy

from tests.gui.scene import OUT, TRIAL, empty, extension, mocap


def steps(user: Any) -> Any:
    """Import, save, move, look and relink."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.drop(str(TRIAL), "Config.toml")
    yield from user.until(lambda: mocap().capture.file, "the capture is read", 240)
    (OUT / "shot").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "shot" / "a.blend"))
    yield 0.5
    file_of = extension("conventions.file_paths").file_of
    old = file_of(mocap().capture.file)
    assert old.is_relative_to(OUT / "shot") and old.is_file(), old
    shutil.move(OUT / "shot" / "mocap", OUT / "archive")
    user.viewport.tag_redraw()
    yield from user.shot("moved")
    yield from user.press("mocap.relink_files(")
    yield from user.accept_file(str(OUT / "archive" / "any"))
    yield from user.until(lambda: file_of(mocap().capture.file).is_file(), "the capture is found again", 20)
    yield 0.5
    yield from user.shot("linked")
    new = file_of(mocap().capture.file)
    user.note(f"{old.relative_to(OUT)} is now {new.relative_to(OUT)}")
    assert new.name == old.name and new.is_relative_to(OUT / "archive")
