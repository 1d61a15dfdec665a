"""Panel craft: every panel open, 200 px wide and at the default width, in English and German, in a full scene.

``python -m tests.gui --script panels.py``: on the demo capture in the factory scene with a hundred collections.
Pictures are of every page of the sidebar.
"""

from __future__ import annotations

import time
from typing import Any

import bpy

from tests.gui.scene import PACKAGE, extension, mocap

_NARROW_PX, _DEFAULT_PX = 200, 283
_COLLECTIONS, _OBJECTS = 100, 10
_TOP_PX = 112
"""From the sidebar's upper edge, below the stages and Hide Cube: the button that solves, the progress and Cancel."""


def steps(user: Any) -> Any:
    """Play it."""
    fill()
    yield from user.open_from_the_start(PACKAGE)
    yield from user.open_tab("MoCap")
    yield from user.narrow(_NARROW_PX)
    yield from user.pages("empty_narrow")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')")
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    yield from pinned(user)
    assert len(bpy.data.collections) > _COLLECTIONS and "Cube" in bpy.data.objects
    yield from every_page(user, "english", _NARROW_PX, _DEFAULT_PX)
    yield from drawing_time(user)
    yield from in_german(user)


def fill() -> None:
    """Put a hundred collections of ten objects into the factory scene."""
    assert "Cube" in bpy.data.objects
    for number in range(_COLLECTIONS):
        collection = bpy.data.collections.new(f"Set {number:03d}")
        bpy.context.scene.collection.children.link(collection)
        for item in range(_OBJECTS):
            collection.objects.link(bpy.data.objects.new(f"Prop {number:03d}.{item}", None))
    bpy.ops.ed.undo_push(message="full scene")


def pinned(user: Any) -> Any:
    """Solve and Cancel stand on top; presets show their own values."""
    region = user.region("UI")
    top = region.y + region.height
    _, y = yield from user.find("mocap.solve()")
    assert top - y < _TOP_PX, (top, y)
    mocap().solve.iterations = 77
    mocap().solve.preset = "FAST"
    yield from user.find("solve.estimate_sync")
    yield from user.shot("values_of_best")
    settings = mocap().solve
    settings.preset, settings.method, settings.iterations, settings.robust_scale = "CUSTOM", "frame", 200, 0.1
    yield from user.press("mocap.solve()")
    yield 2.0
    _, y = yield from user.find("mocap.cancel()")
    assert top - y < _TOP_PX, (top, y)
    yield from user.shot("running")
    yield from user.press("mocap.cancel()")
    yield from user.until(lambda: not bpy.ops.mocap.cancel.poll(), "it is cancelled", 30)
    assert mocap().review.armature is None
    yield from user.find("solve.preset")
    yield from user.shot("cancelled")
    mocap().solve.preset = "FAST"
    yield from user.press("mocap.solve()")
    yield from user.solved("the capture is solved")
    assert mocap().review.take is not None


def every_page(user: Any, language: str, *widths: int) -> Any:
    """Look at all panels at some widths."""
    for width in widths:
        yield from user.narrow(width)
        yield from user.pages(f"{language}_{width}")


def drawing_time(user: Any) -> Any:
    """Note what drawing all panels once costs Blender."""
    start = time.perf_counter()
    with user.override:
        bpy.ops.wm.redraw_timer(type="DRAW", iterations=5)
    user.note(f"the viewport with all panels is drawn in {200 * (time.perf_counter() - start):.0f} ms")
    yield 0.1


def in_german(user: Any) -> Any:
    """Change Blender's language: words of ours are our own German ones, not those of Blender."""
    translate = bpy.app.translations.pgettext_iface
    view = bpy.context.preferences.view
    view.language = "de_DE"
    view.use_translate_interface = view.use_translate_tooltips = True
    yield 1.0
    assert translate("File") != "File", "Blender speaks German"
    words = extension("ui.translation")
    ours = [item.name for item in mocap().solve.bl_rna.properties["preset"].enum_items]
    assert [translate(word, words.CONTEXT) for word in ours] == [words.german()[word] for word in ours]
    user.note(f"'Fast' would be '{translate('Fast')}' without a context of our own")
    yield from every_page(user, "german", _DEFAULT_PX)
    view.language = "en_US"
    yield 0.5
