"""Verbs that read markers: takes, subjects, labels, and live points."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import name_markers
from solver_backend.io.markers.read import read_markers, write_markers
from solver_backend.io.native.motion_file import write_motion, write_subject
from solver_backend.live.frames import from_lines
from solver_backend.synthesis.embedded.demo import DEMO_TAKE
from solver_backend.types import MarkerCloud
from tests.fuzz.odd_motions import worn_subject
from tests.fuzz.odd_values import LINES
from tests.fuzz.target import Target
from tests.fuzz.verbs.running import nothing_left, run_verb, standard_input, verb, verb_target
from tests.support.short_motion import short_motion

_FRAMES = 6
_JSON, _C3D, _WITH_SUBJECT = {".json": "json"}, {".c3d": "binary"}, {".c3d": "binary", ".npz": "npz"}
_LIVE = "--fast --lines ./out.jsonl"


@cache
def short_take(frames: int = _FRAMES) -> MarkerCloud:
    """Return some frames of the embedded take."""
    cloud = read_markers(DEMO_TAKE).cloud
    return replace(cloud, positions=cloud.positions[:frames], residual=None)


def write_take(folder: Path) -> None:
    """Write a short take of labelled markers."""
    write_markers(folder / "take.c3d", short_take())


def _unlabelled(folder: Path) -> None:
    write_markers(folder / "take.c3d", replace(short_take(), labels=None))


def _of_person(folder: Path) -> None:
    write_take(folder)
    labels = short_take().labels or ()
    known = name_markers(labels).known
    places = [known.get(label, "@spine3") for label in labels]
    write_subject(folder / "subject.npz", worn_subject(labels, places, load_body().id))


def _two_takes(folder: Path) -> None:
    _unlabelled(folder)
    write_markers(folder / "like.c3d", short_take())


def _by_hand(folder: Path) -> None:
    _unlabelled(folder)
    points = [{"point": 0, "frame": 1, "marker": "LFHD"}, {"point": 3, "frame": 0, "marker": ""}]
    (folder / "labels.json").write_text(
        json.dumps({"format": "manifold_mocap_user_labels", "version": 1, "points": points})
    )


def _job(folder: Path) -> None:
    _of_person(folder)
    values = {"version": 1, "settings": {"iterations": 1}, "capture": "take.c3d", "out": "out.npz"}
    (folder / "job.json").write_text(json.dumps(values))


def _job_of_person(folder: Path) -> None:
    _job(folder)
    job = json.loads((folder / "job.json").read_text()) | {"subject": "subject.npz", "report": "out.html"}
    (folder / "job.json").write_text(json.dumps(job))


def _marked(folder: Path) -> None:
    markers = np.random.default_rng(0).normal(0.5, 0.1, (_FRAMES, 2, 3))
    marked = replace(
        short_motion(_FRAMES), markers=markers, marker_labels=("A", "B"),
        marker_residual_mm=np.zeros((_FRAMES, 2), np.float32), cleaned_markers=None,
    )  # fmt: skip
    write_motion(folder / "motion.npz", marked)


def _motion(folder: Path) -> None:
    write_motion(folder / "motion.npz", short_motion(_FRAMES, 60.0))


def _points(folder: Path) -> None:
    cloud = short_take()
    rows = [{"t": k / cloud.fps, "points": p[np.isfinite(p).all(-1)].tolist()} for k, p in enumerate(cloud.positions)]
    (folder / "a.txt").write_text("".join(json.dumps(row) + "\n" for row in rows))


def _live_lines(folder: Path) -> object:
    """Run live on standard input and look whether every frame that came is in the recording."""
    text = folder / "a.txt"
    with text.open("rb") as stream:
        came = [frame for frame in from_lines(stream) if not frame.fault]
    with nothing_left(folder), standard_input(text):
        done = run_verb(folder, f"live stream - {_LIVE} --record ./out.c3d")
        kept = read_markers(folder / "out.c3d").cloud.positions if (folder / "out.c3d").exists() else np.zeros(0)
        if len(kept) != len(came) and any(len(frame.points) for frame in came):
            raise AssertionError(f"of {len(came)} frames {len(kept)} are in the recording")
        return done


TARGETS: tuple[Target, ...] = (
    verb_target("markers layout", (write_take,), verb("markers layout ./take.c3d --out ./out.json"), _C3D),
    verb_target(
        "label", (write_take, _unlabelled), verb("markers label ./take.c3d -o ./out.c3d --report ./out.html"), _C3D,
    ),
    verb_target(
        "label, by hand", (_by_hand,), verb("markers label ./take.c3d --labels ./labels.json -o ./a.npz"), _JSON,
    ),
    verb_target(
        "label, like another", (_two_takes,), verb("markers label ./take.c3d --like ./like.c3d -o ./a.trc"), _C3D,
    ),
    verb_target(
        "label of a person", (_of_person,), verb("markers label ./take.c3d --subject ./subject.npz --out ./out.c3d"),
        _WITH_SUBJECT,
    ),
    verb_target("markers calibrate", (write_take,), verb("markers calibrate ./take.c3d --out ./out.npz"), _C3D),
    verb_target("solve, markers", (_job,), verb("solve --job ./job.json"), _C3D),
    verb_target("solve, markers of a person", (_job_of_person,), verb("solve --job ./job.json"), _WITH_SUBJECT),
    verb_target("live stream", (write_take,), verb(f"live stream ./take.c3d {_LIVE} --record ./out.c3d"), _C3D),
    verb_target(
        "live of a person", (_of_person,), verb(f"live stream ./take.c3d {_LIVE} --subject ./subject.npz"),
        _WITH_SUBJECT,
    ),
    verb_target("live, lines", (_points,), _live_lines, {".txt": "text"}, LINES),
    verb_target("live, motion", (_motion,), verb(f"live stream ./motion.npz {_LIVE}"), {".npz": "npz"}),
    verb_target(
        "markers export", (_marked,), verb("markers export ./motion.npz --contents solved --out ./out.c3d"),
        {".npz": "npz"},
    ),
)  # fmt: skip
