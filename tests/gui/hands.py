"""What a user does at Blender's window with mouse and keys; every event goes through Blender's own queue."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import bpy

Steps = Generator[float | None, None, Any]  # Yields seconds to wait, None for one round of the event loop.

_DIGITS = ("ZERO", "ONE", "TWO", "THREE", "FOUR", "FIVE", "SIX", "SEVEN", "EIGHT", "NINE")
_KEYS = {".": "PERIOD", **{str(number): name for number, name in enumerate(_DIGITS)}}
"""Blender's names of the keys of characters that are no letters."""


class Hands:
    """Mouse, keys and eyes; every method that takes time is a generator."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.done: list[str] = []
        self.clicks = 0
        self.which = 0
        """Which of Blender's windows the user is at."""
        self._shots = self._x = self._y = 0

    @property
    def window(self) -> bpy.types.Window:
        """The window that the user is at."""
        return bpy.context.window_manager.windows[self.which]

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
        self._x, self._y = x, y
        self.window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
        yield None

    def click(self, x: int, y: int, **modifiers: bool) -> Steps:
        """Click with the left button."""
        self.clicks += 1
        yield from self.move(x, y)
        yield from self.move(x + 1, y)
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type="LEFTMOUSE", value=value, x=x + 1, y=y, **modifiers)
            yield None
        yield 0.3

    def key(self, kind: str, **modifiers: bool) -> Steps:
        """Press a key over the viewport."""
        region = self.region("WINDOW")
        x, y = region.x + region.width // 3, region.y + region.height // 2
        yield from self.move(x, y)
        yield from self._strike(kind, **modifiers)
        yield 0.4

    def type_text(self, text: str) -> Steps:
        """Type a text into the field that is being edited, in place of what stands there, and confirm it."""
        yield from self._strike("A", ctrl=True)
        for letter in text:
            kind = _KEYS.get(letter, letter.upper() if letter.isascii() and letter.isalpha() else "O")
            self.window.event_simulate(type=kind, value="PRESS", unicode=letter, x=self._x, y=self._y)
            yield None
            self.window.event_simulate(type=kind, value="RELEASE", x=self._x, y=self._y)
            yield None
        yield from self._strike("RET")
        yield 0.3

    def _strike(self, kind: str, **modifiers: bool) -> Steps:
        """Press and release a key where the mouse is."""
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type=kind, value=value, x=self._x, y=self._y, **modifiers)
            yield None

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
        params.directory = str(Path(path).parent).encode()
        if not params.is_property_readonly("filename"):  # as it is where a folder is chosen
            params.filename = Path(path).name
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
