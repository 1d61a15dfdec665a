"""Several people: a session by one drop, its people named, solved together, reviewed each by their own body.

``python -m tests.gui --script people.py``: on the session of Pose2Sim with two people (and a third who passes).
"""

from __future__ import annotations

from typing import Any

import bpy

from tests.gui.scene import OUT, SESSION, empty, mocap

_SHOWN_FRAME = 40
_ROW_PX = 20
"""Height of a row of the list; in Blender 5.2 a pixel more."""
_ROWS = 3


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.drop(str(SESSION), "Config.toml")
    yield from user.until(lambda: len(mocap().captures) == 3, "three trials are read", 300)
    yield 1.0
    assert [capture.frames for capture in mocap().captures] == [12, 12, 100]
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.shot("session")
    yield from user.press("mocap.show_capture(index=2)")
    yield from named(user)
    yield from together(user)
    yield from each_by_their_body(user)
    yield from all_captures(user)


def named(user: Any) -> Any:
    """Choose the second person and give them a name."""
    people = mocap().capture.people
    user.note(f"people: {[(p.name, p.frames, round(p.views, 1)) for p in people]}")
    assert len(people) >= 2 and people[0].name == "Person 1"
    x, y = yield from chosen(user, 1)
    yield from user.click(x, y, ctrl=True)
    yield from user.type_text("Björn")
    assert mocap().capture.people[1].name == "Björn", mocap().capture.people[1].name
    yield from user.shot("named")


def chosen(user: Any, person: int) -> Any:
    """Click on a person in the list and return where that was."""
    x, y = yield from user.find("person_shown", 0.4)
    for px in sorted(range(-_ROWS * _ROW_PX, _ROWS * _ROW_PX + 1, _ROW_PX // 2), key=abs):
        if not (yield from user.stays("person_shown", x, y + px)):
            continue  # above the list is its panel's header, and a click closes the panel
        yield from user.click(x, y + px)
        if mocap().capture.person_shown == person:
            return x, y + px
    raise AssertionError(f"No click on the list chooses person {person}")


def together(user: Any) -> Any:
    """Solve everybody."""
    yield from user.press("mocap.solve_all(scope='CAPTURE')")
    yield 3.0
    yield from user.shot("solving_all")
    yield from user.solved("everybody is solved")
    bodies = [review.armature for review in mocap().capture.reviews]
    assert len({body.name for body in bodies}) == len(mocap().capture.people)
    assert "Björn" in bodies[1].name and "Björn" in mocap().capture.reviews[1].take.name
    bpy.context.scene.frame_set(_SHOWN_FRAME)
    pelvis = [body.pose.bones["pelvis"].head for body in bodies[:2]]
    assert (pelvis[0] - pelvis[1]).length > 0.5
    user.look_at((pelvis[0] + pelvis[1]) / 2, 5.0)
    yield 1.0
    yield from user.shot("all_solved")


def each_by_their_body(user: Any) -> Any:
    """Review whose body is active, or who is chosen from the list; undo takes all of them back."""
    first, second = (review.armature for review in mocap().capture.reviews[:2])
    bpy.context.view_layer.objects.active = first
    user.viewport.tag_redraw()
    yield 0.5
    assert mocap().review.armature == first and mocap().capture.person.name == "Person 1"
    yield from user.shot("first_is_active")
    yield from chosen(user, 1)
    assert mocap().review.armature == second and bpy.context.view_layer.objects.active == second
    yield from user.open_panel("VIEW3D_PT_mocap_formats")
    yield from user.press("format='csv'", 0.25)
    yield from user.accept_file(str(OUT / "Björn.csv"))
    yield from user.until((OUT / "Björn.csv").is_file, "the second one's take is exported", 120)
    takes = len(bpy.data.actions)
    yield from user.press("mocap.solve()")
    yield from user.solved("the second one alone is solved anew")
    assert len(bpy.data.actions) == takes + 1 and mocap().review.take["person"] == "Person 2"
    yield from user.shot("second_again")
    yield from user.key("Z", ctrl=True)
    yield 1.0
    assert len(bpy.data.actions) == takes and mocap().capture.people[1].name == "Björn", "undone"


def all_captures(user: Any) -> Any:
    """Solve everybody in all trials."""
    takes = len(bpy.data.actions)
    count = sum(max(1, len(capture.people)) for capture in mocap().captures)
    yield from user.press("mocap.solve_all(scope='SCENE')")
    yield from user.solved("everybody in all trials is solved")
    assert len(bpy.data.actions) == takes + count, (takes, count, len(bpy.data.actions))
    assert all(review.take is not None for capture in mocap().captures for review in capture.reviews)
    yield from user.shot("all_trials")
    yield from user.key("Z", ctrl=True)
    yield 1.0
    assert len(bpy.data.actions) == takes, "undone in one step"
    user.note("all solves are undone in one step")
