"""Plays a script at Blender's window (``blender --enable-event-simulate --python driver.py -- FOLDER SCRIPT``).

Screenshots are asked for by a file and taken from outside.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parents[2]))  # Blender runs this file by its path

from tests.gui.hands import Steps
from tests.gui.user import User

_ROUND_S = 0.02
_END = -1.0


def play(steps: Callable[[User], Steps], folder: Path) -> None:
    """Run a script's steps by a timer, write the record, and leave Blender."""
    bpy.context.preferences.view.show_splash = False
    user = User(folder)
    generator = _watched(steps(user), user)

    def tick() -> float | None:
        wait = next(generator, _END)
        return _ROUND_S if wait is None else wait if wait != _END else None

    bpy.app.timers.register(tick, first_interval=1.5, persistent=True)  # a script may open another file


def _watched(steps: Steps, user: User) -> Steps:
    """Play the steps; where they fail, have a picture of it taken; write the record and leave Blender."""
    failure = ""
    try:
        yield from steps
    except BaseException:
        failure = traceback.format_exc()
        with suppress(AssertionError):
            yield from user.shot("failure")
    _finish(user, failure)


def _finish(user: User, failure: str) -> None:
    record = {"blender": bpy.app.version_string, "done": user.done, "failure": failure}
    (user.folder / "record.json").write_text(json.dumps(record, indent=1))
    bpy.ops.wm.quit_blender()


def _main() -> None:
    folder, script = (Path(text) for text in sys.argv[sys.argv.index("--") + 1 :][:2])
    spec = importlib.util.spec_from_file_location("script", script)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    play(module.steps, folder)


if __name__ == "__main__":
    _main()
