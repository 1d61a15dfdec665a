"""Figures from the real application: ``python -m tests.gui --script live_speed.py``.

How often the viewport is drawn while a body is live, how long a look at the newest pose takes, and how long Blender is
kept from anything else at most: body, points and the colours of their doubt are on the screen.
"""

from __future__ import annotations

import time
from typing import Any

import bpy
import numpy as np

from tests.gui.recordings import KATA
from tests.gui.scene import OUT, PACKAGE, empty, extension, mocap

_SECONDS = 4.0


def steps(user: Any) -> Any:
    """Replay a recording, count what is drawn, look at it."""
    empty()
    yield from user.open_from_the_start(PACKAGE)
    yield from user.open_acquisition(PACKAGE)
    live = extension("ui.operators.live").live
    mocap().live.source = str(OUT / KATA)
    user.viewport.tag_redraw()
    yield 0.3
    yield from user.press("mocap.live_start()")
    yield from user.until(lambda: live.run and live.run.shown > 5, "poses are shown", 300)
    user.look_at((0.0, 0.0, 0.9), 3.5)
    yield 1.0
    yield from _measured(user, live, "as it is")
    yield from user.shot("live_doubt")
    names = [getattr(live.figure, part) for part in ("points", "joints", "armature", "mesh")]
    for name in names:
        bpy.data.objects[name].hide_viewport = True
    yield from _measured(user, live, "an empty viewport")
    for name in names:
        bpy.data.objects[name].hide_viewport = False
    _cheap_to_draw(user)
    yield 1.0
    yield from _measured(user, live, "a small viewport without anti-aliasing and overlays")
    yield from user.shot("live_small")
    assert live.run.latest.sigma_m is not None and len(live.run.latest.off_m) == len(live.run.latest.points)
    bpy.ops.mocap.live_stop()
    yield from user.until(lambda: not live.busy, "live is stopped", 300)


def _cheap_to_draw(user: Any) -> None:
    """Leave the processor, which draws in the place of a graphics card, as little to draw as can be."""
    bpy.context.preferences.system.viewport_aa = "OFF"
    others = [area for area in bpy.context.screen.areas if area.type != "VIEW_3D"]
    for area in others:
        area.type = "CONSOLE"
    before = set(bpy.context.screen.areas)
    with user.override:
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.3)
        bpy.ops.screen.area_split(direction="HORIZONTAL", factor=0.4)
    for area in set(bpy.context.screen.areas) - before:
        area.type = "CONSOLE"
    for area in bpy.context.screen.areas:
        if area.type == "VIEW_3D":
            space = area.spaces.active
            space.show_region_ui = space.show_region_toolbar = space.show_region_header = False
            space.overlay.show_overlays = space.show_gizmo = False
            space.shading.light = "FLAT"


def _measured(user: Any, live: Any, what: str) -> Any:
    drawn: list[float] = []
    looks: list[float] = []
    begun = [0.0]
    shower, run = extension("ui.operators.live"), live.run
    poll, redraw = run.poll, shower.redraw

    def polled() -> Any:
        begun[0] = time.perf_counter()
        return poll()

    def redrawn(*kinds: str) -> None:
        redraw(*kinds)
        looks.append(time.perf_counter() - begun[0])

    run.poll, shower.redraw = polled, redrawn
    space = bpy.types.SpaceView3D
    handler = space.draw_handler_add(lambda: drawn.append(time.perf_counter()), (), "WINDOW", "POST_VIEW")
    start, processor, shown = time.perf_counter(), time.process_time(), run.shown
    yield _SECONDS
    wall, processor, shown = time.perf_counter() - start, time.process_time() - processor, run.shown - shown
    space.draw_handler_remove(handler, "WINDOW")
    run.poll, shower.redraw = poll, redraw
    gaps, looks_ms = 1e3 * np.diff(drawn), 1e3 * np.array(looks)
    user.note(f"{what}: {len(drawn) / wall:.1f} redraws and {shown / wall:.1f} new poses a second")
    user.note(f"a look takes {np.median(looks_ms):.1f} ms, {np.percentile(looks_ms, 99):.1f} in the 99th percentile")
    user.note(f"from one redraw to the next {np.median(gaps):.0f} ms, {np.percentile(gaps, 99):.0f} in the 99th")
    user.note(f"Blender used {processor / wall:.2f} processors, {1e3 * processor / max(len(drawn), 1):.1f} ms a redraw")
