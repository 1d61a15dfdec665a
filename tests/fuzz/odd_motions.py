"""Motions, bodies, subjects and jobs that are odd or cannot be: read with a problem, or refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.native.motion_file import write_motion, write_subject
from solver_backend.types import MarkerSubject, Motion
from tests.fuzz.target import Write, file
from tests.support.scenes import small_motion


def worn_subject(
    labels: Sequence[str] = ("LASI", "C7"), places: Sequence[str] = ("LASI", "@spine3"), body: str = "neutral"
) -> MarkerSubject:
    """Return a person who wears these markers in these places."""
    skin, count = np.where([place.startswith("@") for place in places], np.nan, 0.01), len(labels)
    return MarkerSubject(
        body, np.zeros(10), tuple(labels), tuple(places), np.full((count, 3), 0.01), np.full(count, 0.004), skin,
        {"takes": ["a"]},
    )  # fmt: skip


SUBJECTS: tuple[Write, ...] = (lambda folder: write_subject(folder / "a.npz", worn_subject()),)
"""A subject file that is read."""


def changed(write: Write, **arrays: object) -> Write:
    """Return what writes ``a.npz`` and then changes, adds or (None) leaves out some of its arrays."""

    def write_changed(folder: Path) -> None:
        write(folder)
        with np.load(folder / "a.npz") as stored:
            kept = {name: stored[name] for name in stored.files}
        kept |= {name: np.asarray(value) for name, value in arrays.items() if value is not None}
        np.savez(folder / "a.npz", **{name: value for name, value in kept.items() if arrays.get(name, 0) is not None})

    return write_changed


def _motion(change: Callable[[Motion], Motion]) -> Write:
    return lambda folder: write_motion(folder / "a.npz", change(small_motion(4)))


def _twisted(motion: Motion) -> Motion:
    return replace(motion, body_pose=np.tile(np.float32([0.0, 0.0, 3.0]), (4, 23)))


_FORGED: tuple[dict[str, Any], ...] = (
    {"provenance": "{"}, {"provenance": "[1]"}, {"mocap_framerate": 0.0}, {"mocap_framerate": 1e7},
    {"mocap_framerate": 5000.0}, {"mocap_framerate": "fast"}, {"version": 99}, {"format": "other"}, {"poses": None},
    {"trans": np.full((4, 3), 1e9)}, {"trans": np.full((4, 3), np.nan)}, {"betas": np.zeros(3)},
    {"joint_set": "NONE"}, {"keyframes": np.zeros(3, bool)}, {"poses": np.zeros((4, 150))}, {"poses": np.zeros(4)},
    {"markers": np.zeros((4, 2, 3))}, {"joints": np.array([{}], dtype=object)}, {"betas": "none"},
    {"format": None, "joints": None}, {"betas": np.full(10, 20.0)}, {"provenance": "[" * 5000},
    {"mocap_framerate": np.nan}, {"mocap_framerate": 1e300}, {"mocap_framerate": -60.0}, {"betas": np.full(10, 1e30)},
    {"trans": np.full((4, 3), 7e37)}, {"poses": np.full((4, 156), 1e30)},
    *({"provenance": json.dumps({key: value})} for key in ("findings", "resolved", "settings", "sigma_px", "person")
      for value in (1.5, ["x"], {"a": 1})),
    {"poses": np.zeros((0, 72)), "trans": np.zeros((0, 3)), "joints": None},
)  # fmt: skip
MOTIONS: tuple[Write, ...] = (
    _motion(lambda motion: replace(motion, transl=np.float32([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]]))),
    _motion(lambda motion: replace(motion, betas=np.full(10, 9.0, np.float32))),
    _motion(_twisted),
    _motion(lambda motion: replace(motion, fps=900.0)),
    *(changed(_motion(lambda motion: motion), **forged) for forged in _FORGED),
)
"""Motion files; what else is not one."""
ODD_SUBJECTS: tuple[Write, ...] = tuple(
    changed(SUBJECTS[0], **arrays)
    for arrays in (
        {"provenance": "{"}, {"provenance": "[]"}, {"marker_sigma": np.zeros(2)}, {"marker_labels": ["C7", "C7"]},
        {"offsets": np.zeros((3, 3))}, {"offsets": np.full((2, 3), np.inf)}, {"format": "other"}, {"version": 7},
        {"betas": None}, {"marker_places": ["LASI"]}, {"marker_labels": 3},
    )
)  # fmt: skip
AMASS: tuple[dict[str, Any], ...] = (
    {"poses": np.zeros((4, 10))}, {"poses": None}, {"poses": np.full((4, 156), np.nan)}, {"mocap_framerate": None},
    {"mocap_framerate": np.array(-1.0)}, {"mocap_framerate": np.array(np.nan)}, {"gender": None}, {"gender": 5},
    {"gender": "other"}, {"betas": None}, {"trans": None}, {"betas": np.full(16, 9.0)},
)  # fmt: skip
"""Arrays of an AMASS file that are others or left out."""
_JOB = {"version": 1, "capture": "c.npz", "out": "m.npz"}


JOBS: tuple[Write, ...] = (
    file("job.json", json.dumps({"version": 1})),
    file("job.json", "[]"),
    file("job.json", "{"),
    *(
        file("job.json", json.dumps(_JOB | more))
        for more in (
            {"version": 9}, {"unknown": 1}, {"fps": "fast"}, {"fps": -1}, {"joint_set": "NONE"}, {"settings": []},
            {"settings": {"unknown": 1}}, {"settings": {"window": 1}}, {"settings": {"betas": [1.0]}},
            {"settings": {"layout": "l.json", "body": "bodies/b.npz"}}, {"resolve": {"motion": "m.npz"}},
            {"resolve": {"motion": 3, "first": 0, "last": 1}}, {"trim": "yes"}, {"unit": 5}, {"subject": 5},
            {"resolve": {"first": 0, "last": 1}}, {"capture": "a\0b.npz"}, {"report": "\0.html"},
            {"settings": {"layout": "\0.json"}},
        )
    ),
)  # fmt: skip
"""Job files."""


def _nothing(folder: Path) -> None:
    (folder / "other.json").write_text("{}")


def _folder(folder: Path) -> None:
    (folder / "job.json").mkdir()
    _nothing(folder)


NO_JOBS: tuple[Write, ...] = (_nothing, _folder)  # Where a job file should be there is none.
