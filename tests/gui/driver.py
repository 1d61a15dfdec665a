"""A user at Blender's window: finds buttons by hovering over them, clicks, types and looks.

Runs inside Blender (``blender --enable-event-simulate --python driver.py -- FOLDER SCRIPT``). Every event goes through
Blender's own queue. Which button lies under the mouse is asked with Blender's own "Copy Python Command" and "Copy Data
Path". Screenshots are asked for by a file and taken from outside.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import time
import traceback
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import bpy

Steps = Generator[float | None, None, Any]
"""Yields seconds to wait, None for one round of the event loop."""
_ROUND_S = 0.02
_STEP_PX = 14
_NEAR_PX = 20


class User:
    """What a user can do; every method that takes time is a generator."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.done: list[str] = []
        self._shots = 0
        self._last_y = 10_000

    @property
    def window(self) -> bpy.types.Window:
        """The main window."""
        return bpy.context.window_manager.windows[0]

    @property
    def viewport(self) -> bpy.types.Area:
        """The 3D viewport."""
        return next(area for area in self.window.screen.areas if area.type == "VIEW_3D")

    def region(self, kind: str) -> bpy.types.Region:
        """A region of the viewport."""
        return next(region for region in self.viewport.regions if region.type == kind)

    @property
    def override(self) -> Any:
        """Context of the viewport's sidebar."""
        return bpy.context.temp_override(window=self.window, area=self.viewport, region=self.region("UI"))

    def open_tab(self, name: str) -> Steps:
        """Show the sidebar with one tab, wide enough to read."""
        self.viewport.spaces.active.show_region_ui = True
        yield 0.3
        self.region("UI").active_panel_category = name
        self.viewport.tag_redraw()
        yield 0.5

    def look_at(self, point: tuple[float, float, float], distance_m: float) -> None:
        """Turn the viewport to a point."""
        view = self.viewport.spaces.active.region_3d
        view.view_location, view.view_distance = point, distance_m

    def move(self, x: int, y: int) -> Steps:
        """Move the mouse."""
        self.window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
        yield None

    def click(self, x: int, y: int) -> Steps:
        """Click with the left button."""
        yield from self.move(x, y)
        yield from self.move(x + 1, y)
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type="LEFTMOUSE", value=value, x=x + 1, y=y)
            yield None
        yield 0.3

    def key(self, kind: str, **modifiers: bool) -> Steps:
        """Press a key over the viewport."""
        region = self.region("WINDOW")
        x, y = region.x + region.width // 3, region.y + region.height // 2
        yield from self.move(x, y)
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type=kind, value=value, x=x, y=y, **modifiers)
            yield None
        yield 0.4

    def under_mouse(self) -> str:
        """What the button under the mouse does: its Python command or its data path."""
        manager = bpy.context.window_manager
        for ask in (bpy.ops.ui.copy_python_command_button, bpy.ops.ui.copy_data_path_button):
            with self.override:
                if ask.poll():
                    manager.clipboard = ""
                    ask()
                    if manager.clipboard:
                        return manager.clipboard
        return ""

    def find(self, words: str, across: float = 0.5) -> Generator[float | None, None, tuple[int, int]]:
        """Hover over the sidebar, near the last find first and scrolling if need be, until a button holds the words."""
        region = self.region("UI")
        x = int(region.x + across * (region.width - 24))
        seen: set[str] = set()
        for scroll in (0, -60, 8, 8, 8):
            yield from self._scroll(scroll)
            heights = range(region.y + region.height - 6, region.y + 6, -_STEP_PX)
            for y in sorted(heights, key=lambda y: abs(y - self._last_y)) if scroll == 0 else heights:
                yield from self.move(x, y)
                found = self.under_mouse()
                seen.add(found)
                if words in found and (yield from self._stays(words, x, y)):
                    self._last_y = y
                    return x, y
        raise AssertionError(f"No button '{words}' in the sidebar; there are {sorted(seen)}")

    def press(self, words: str, across: float = 0.5) -> Steps:
        """Find a button and click it."""
        x, y = yield from self.find(words, across)
        yield from self.click(x, y)
        self.note(f"clicked {words}")

    def open_panel(self, name: str, *, at_the_end: bool = False) -> Steps:
        """Open a closed panel by a click on its header; which header it is shows when the panel is drawn.

        Headers are tried from what was clicked last downwards or, if so told, from the sidebar's end upwards.
        """
        panel, drawn = getattr(bpy.types, name), []
        draw = panel.draw

        def noticed(shown: bpy.types.Panel, context: bpy.types.Context) -> None:
            drawn.append(name)
            draw(shown, context)

        panel.draw = noticed
        try:
            self.viewport.tag_redraw()
            yield 0.3
            if not drawn:
                yield from self._click_headers(drawn, at_the_end)
        finally:
            panel.draw = draw
        self.note(f"opened {name}")

    def _click_headers(self, drawn: list[str], at_the_end: bool) -> Steps:
        """Click on what is no button until the panel is drawn; other panels are opened and closed again."""
        region = self.region("UI")
        x = int(region.x + 0.3 * (region.width - 24))
        heights = range(region.y + region.height - 6, region.y + 6, -_STEP_PX)
        near = sorted(heights, key=lambda y: (y >= self._last_y, -y))
        ways = [(60, heights[::-1])] if at_the_end else [(0, near)]
        for scroll, tried in (*ways, (-60, heights), *[(12, heights)] * 12):
            yield from self._scroll(scroll)
            yield 0.1
            for y in tried:
                yield from self.move(x, y)
                if self.under_mouse() or not (yield from self._stays("", x, y)):
                    continue
                yield from self.click(x, y)
                yield 0.2
                if drawn:
                    self._last_y = y
                    return
                yield from self.click(x, y)
        raise AssertionError("No header opens the panel")

    def narrow(self, width: int) -> Steps:
        """Drag the sidebar's edge until it is so wide; what can be grabbed lies a little off it."""
        for beside in (8, 0, 4, 12):
            region = self.region("UI")
            x, y = region.x + beside, region.y + region.height - 60  # where panels are: the empty lets clicks through
            to = x + region.width - width
            yield from self.move(x - 30, y)
            yield from self.move(x, y)
            yield 0.2
            self.window.event_simulate(type="LEFTMOUSE", value="PRESS", x=x, y=y)
            yield None
            for step in range(1, 21):
                yield from self.move(x + (to - x) * step // 20, y)
            self.window.event_simulate(type="LEFTMOUSE", value="RELEASE", x=to, y=y)
            yield 0.5
            if abs(self.region("UI").width - width) <= _NEAR_PX:
                break
        self.note(f"the sidebar is {self.region('UI').width} px wide")
        assert abs(self.region("UI").width - width) <= _NEAR_PX

    def drop(self, folder: str, name: str) -> Steps:
        """Drop a file on the viewport."""
        with self.override:
            bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=f"{folder}/", files=[{"name": name}])
        yield 0.3

    def solved(self, what: str, seconds: float = 900) -> Steps:
        """Wait until no run is under way any more."""
        yield 0.5
        yield from self.until(lambda: not bpy.ops.mocap.cancel.poll(), what, seconds)
        yield 0.5

    def accept_file(self, path: str) -> Steps:
        """Name a file in the file browser that is open, and accept it."""
        yield from self.until(lambda: self._browser() is not None, "the file browser is open", 20)
        window, area = self._browser() or (None, None)
        params = area.spaces.active.params
        params.directory, params.filename = str(Path(path).parent).encode(), Path(path).name
        yield 0.3
        with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
            bpy.ops.file.execute()
        yield 0.5

    def _browser(self) -> tuple[bpy.types.Window, bpy.types.Area] | None:
        areas = [(w, area) for w in bpy.context.window_manager.windows for area in w.screen.areas]
        return next(((w, area) for w, area in areas if area.type == "FILE_BROWSER"), None)

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 300) -> Steps:
        """Wait for something to become true."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"Waited {seconds} s in vain until {what}"
            yield 0.1
        self.note(what)

    def shot(self, name: str) -> Steps:
        """Have a screenshot taken."""
        self._shots += 1
        file = self.folder / f"{self._shots:02d}_{name}.png"
        yield 0.6
        (self.folder / "SHOT").write_text(file.name)
        yield from self.until(lambda: not (self.folder / "SHOT").exists(), f"picture {file.name}", 30)

    def note(self, text: str) -> None:
        """Keep a line of the record."""
        self.done.append(text)
        print("step:", text, flush=True)  # noqa: T201 - for the console log

    def _stays(self, words: str, x: int, y: int) -> Generator[float | None, None, bool]:
        """Whether the button is still there once Blender has caught up with the mouse."""
        yield 0.15
        yield from self.move(x + 1, y)
        yield 0.1
        found = self.under_mouse()
        return words in found if words else not found

    def _scroll(self, lines: int) -> Steps:
        region = self.region("UI")
        x, y = region.x + region.width // 2, region.y + region.height // 2
        for _ in range(abs(lines)):
            self.window.event_simulate(type="WHEELDOWNMOUSE" if lines > 0 else "WHEELUPMOUSE", value="PRESS", x=x, y=y)
            yield None


def play(steps: Callable[[User], Steps], folder: Path) -> None:
    """Run a script's steps by a timer, write the record, and leave Blender."""
    bpy.context.preferences.view.show_splash = False
    user = User(folder)
    generator = steps(user)

    def tick() -> float | None:
        try:
            wait = next(generator)
        except StopIteration:
            return _finish(user, "")
        except BaseException:
            return _finish(user, traceback.format_exc())
        return _ROUND_S if wait is None else wait

    bpy.app.timers.register(tick, first_interval=1.5, persistent=True)  # a script may open another file


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
