"""The panel *Studio*: a benchmark of a ring of cameras, its map on the floor, a data set checked, made, gone on with.

``python -m tests.gui --script studio.py``: small pictures, few frames.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from tests.gui.scene import OUT, PACKAGE, empty, extension, mocap


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_from_the_start(PACKAGE)
    yield from user.open_acquisition(PACKAGE)
    yield from user.narrow(200)
    yield from user.shot("narrow")
    yield from user.narrow(283)
    settings = mocap().studio
    settings.array, settings.count = "RING", 4
    user.viewport.tag_redraw()
    yield 0.3
    yield from benchmark(user)
    yield from data_set(user)


def benchmark(user: Any) -> Any:
    """Say what the ring reaches, with and without its last camera."""
    mocap().studio.fewer = True
    yield from user.press("mocap.benchmark()")
    yield 3.0
    yield from user.shot("judging")
    yield from user.solved("the ring is judged")
    rows = mocap().studio.rows
    user.note(f"rows: {[(row.array, row.reached, round(row.median_mm, 1)) for row in rows]}")
    assert len(rows) == 2 and 0 < rows[0].median_mm < rows[1].median_mm
    shown = extension("studio.places").MAP
    assert [obj[shown] for obj in bpy.data.objects if shown in obj] == [rows[0].array]
    user.look_at((0.0, 0.0, 0.0), 9.0)
    yield from user.find("mocap.benchmark()")
    yield from user.shot("judged")
    yield from user.press("mocap.show_places(index=1)", 0.83)
    assert [obj[shown] for obj in bpy.data.objects if shown in obj] == [mocap().studio.rows[1].array]
    yield from user.press("mocap.clear_benchmarks()")
    assert not [obj for obj in bpy.data.objects if shown in obj] and not len(mocap().studio.rows)
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert len(mocap().studio.rows) == 2 and [obj for obj in bpy.data.objects if shown in obj], "undone"


def data_set(user: Any) -> Any:
    """Check, change a setting, check again, make, and go on where everything is done."""
    settings = mocap().studio
    settings.frames, settings.scale, settings.film, settings.out = 6, 0.25, {"depth", "masks"}, str(OUT / "Daten ü")
    user.viewport.tag_redraw()
    yield 0.3
    yield from user.press("mocap.check_data_set()")
    yield from user.solved("it is said what would be made", 120)
    assert mocap().studio.planned.startswith("1 shot, 6 frames"), mocap().studio.planned
    yield from user.shot("checked")
    yield from user.press("mocap.make_data_set()")
    yield 2.0
    yield from user.shot("filming")
    yield from user.solved("it is filmed")
    made = Path(bpy.path.abspath(mocap().studio.planned_out))
    pictures = {path: path.stat().st_mtime_ns for path in (made / "shots").rglob("*.png")}
    assert (made / "card.md").is_file() and len(pictures) >= 2 * 4 * 6, len(pictures)
    yield from user.press("mocap.make_data_set()")
    yield from user.solved("nothing is filmed twice")
    assert {path: path.stat().st_mtime_ns for path in pictures} == pictures
    yield from user.shot("made")
