"""A session of several people and trials, by one drop and one click: listed, named, solved, each with its panels.

``python -m tests.gui --script people.py``.
"""

from __future__ import annotations

from typing import Any

import bpy

SESSION = "/work_io/Sitzung ü"


def mocap() -> Any:
    """Return the scene's settings; undo makes earlier references invalid."""
    return bpy.context.scene.mocap


def bodies() -> list[Any]:
    """Return the bodies of everybody in all captures."""
    return [review.armature for capture in mocap().captures for review in capture.reviews]


def steps(user: Any) -> Any:
    """Drop the session, name one, solve all, choose another."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    bpy.ops.ed.undo_push(message="empty scene")
    yield from user.open_tab("MoCap")
    yield from user.drop(SESSION, "Config.toml")
    yield from user.until(lambda: len(mocap().captures) == 3, "three trials are read", 180)
    yield 1.0
    frames = [(capture.name, capture.frames, len(capture.people)) for capture in mocap().captures]
    user.note(f"trials: {frames}")
    assert [row[1:] for row in frames] == [(12, 0), (12, 0), (100, 3)]
    yield from user.press("mocap.show_capture(index=2)")
    mocap().capture.people[1].name = "Björn"
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.shot("three_trials")
    yield from user.press("mocap.solve_all(scope='SCENE')")
    yield 3.0
    yield from user.shot("solving_all")
    yield from user.until(lambda: all(body is not None for body in bodies()), "everybody is solved", 1200)
    yield 1.0
    assert len({body.name for body in bodies()}) == 5
    assert "Björn" in mocap().captures[2].people[1].review.take.name
    yield from user.shot("all_solved")
    second = mocap().captures[2].people[1].review.armature
    mocap().capture.person_shown = 1
    assert mocap().review.armature == second and bpy.context.view_layer.objects.active == second
    user.look_at(second.pose.bones["pelvis"].head, 6.0)
    yield 1.0
    yield from user.shot("the_second_persons_review")
    yield from user.key("Z", ctrl=True)
    yield 1.0
    user.note(f"after one undo {sum(body is not None for body in bodies())} of 5 bodies are left")
