"""The table of valid but wrong recordings: how each is made from the demo's, and what the outputs state."""

from __future__ import annotations

import html
import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from solver_backend.cli.main import function_of
from solver_backend.cli.outcome import Outcome
from solver_backend.cli.program import parse
from solver_backend.exchange.command import Report
from solver_backend.exchange.diagnostics import Diagnostic, read_diagnostics, sentence
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.progress import silent
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.benchmarks.spoiled_views.further_lies import FURTHER_LIES
from tests.benchmarks.spoiled_views.kinds import KINDS, Recording, in_unit
from tests.benchmarks.spoiled_views.lies import LIES, mirrored, still
from tests.benchmarks.spoiled_views.more_lies import MORE_LIES
from tests.benchmarks.spoiled_views.trial import error_mm
from tests.support.trial_files import write_trial

FRAMES, FPS = 120, 60.0
SQUAT = 63
"""Frame of the demo with the lowest hips, 0.63 m above the floor."""
SCALED, SLIGHTLY_SCALED, FULL = 1.25, 1.1, "as it should be"
AS_TEXT = tuple(sorted(range(FRAMES), key=str))
"""Frames in the order of their numbers as texts."""
_BEGIN = 24  # Number of letters that identify a sentence in wrapped text.
Spoil = Callable[[Recording, np.random.Generator], Recording]


@dataclass(frozen=True)
class Lie:
    """One row: the change that makes a recording wrong but not invalid."""

    spoil: Spoil
    fps: float = FPS
    """Frame rate in its configuration. The true rate is ``FPS``."""
    of_time: bool = False
    """True if only times are wrong. Poses compared with the truth frame by frame do not show this."""
    of_size: bool = False
    """True if only the size is wrong, and is still plausible for a person."""
    words: tuple[str, ...] = ()
    """Words that are added to the command."""
    order: tuple[int, ...] | None = None
    """Frames of the truth, if they are in another order."""
    held: int | None = None
    """Frame that is the truth throughout, if the person holds it."""


@dataclass(frozen=True)
class Found:
    """Result of a row."""

    refused: bool = False
    error_mm: float = float("nan")
    """Joint error after rigid alignment with the truth, NaN if the recording was refused."""
    named: tuple[str, ...] = ()
    """Codes of warnings and notes, or the error's code."""
    missing: tuple[str, ...] = field(default=())
    """Warnings that are missing in console, report or JSON."""
    says: str = ""
    """First sentence of the first warning, or the error's message."""
    length_stated: bool = False
    """True if console, report and JSON state the take's length, its rate, and the rate's origin."""
    size_stated: bool = False
    """True if console, report and JSON state the person's height."""


def _known(name: str) -> Spoil:
    made = (KINDS | LIES | MORE_LIES | FURTHER_LIES)[name]
    return lambda recording, rng: made(recording, rng, 0)


def _moved_numbers(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return the recording with each camera's calibration number exchanged for its neighbour's."""
    cameras = recording.cameras
    order = np.roll(np.arange(len(cameras)), 1)
    return replace(recording, cameras=replace(cameras, K=cameras.K[order], R=cameras.R[order], t=cameras.t[order]))


def _squat(recording: Recording, rng: np.random.Generator) -> Recording:
    held = replace(recording, xy=np.roll(recording.xy, -SQUAT, 1), confidence=np.roll(recording.confidence, -SQUAT, 1))
    return still(held, rng)


ROWS: dict[str, Lie] = {
    FULL: Lie(_known(FULL)),
    "scaled by 1.25": Lie(lambda r, g: in_unit(r, SCALED)),
    "cm for m": Lie(_known("cm")),
    "own unit": Lie(_known("own unit")),
    "half size": Lie(_known("half size")),
    "one half size": Lie(_known("one half size")),
    "v from below": Lie(_known("v from below")),
    "one mirrored": Lie(_known("one mirrored")),
    "two mirrored": Lie(lambda r, g: mirrored(r, np.arange(2))),
    "all mirrored": Lie(_known("all mirrored")),
    "one late": Lie(_known("one late")),
    "cameras exchanged": Lie(_known("cameras exchanged")),
    "numbers of other cameras": Lie(_moved_numbers),
    "confidence 0.01": Lie(_known("confidence 0.01")),
    "confidence 1": Lie(_known("confidence 1")),
    "lenses 10 % long": Lie(_known("lenses 10 % long"), of_size=True),  # 120 frames show it only by 2.4 σ.
    "one lens 10 % long": Lie(_known("one lens 10 % long")),
    "sides exchanged": Lie(_known("sides exchanged")),
    "scaled by 1.1": Lie(lambda r, g: in_unit(r, SLIGHTLY_SCALED), of_size=True),
    "stature of 1.5 m given": Lie(_known(FULL), words=("--stature", "1.5")),
    "one moved 20 cm": Lie(_known("one moved 20 cm")),
    "frames sorted as text": Lie(_known("frames sorted as text"), order=AS_TEXT),
    "a poster for the person": Lie(_known("a poster for the person")),
    "lower legs exchanged": Lie(_known("lower legs exchanged")),
    "elbow and wrist exchanged": Lie(_known("elbow and wrist exchanged")),
    "rate doubled": Lie(_known(FULL), fps=2 * FPS, of_time=True),
    "rate halved": Lie(_known(FULL), fps=FPS / 2, of_time=True),
    "pictures dropped": Lie(_known("pictures dropped")),
    "person away": Lie(_known("person away")),
    "somebody crosses": Lie(_known("somebody crosses")),
    "still": Lie(_known("still"), held=0),
    "squat": Lie(_squat, held=SQUAT),
    "other layout": Lie(_known("other layout")),
}
"""Rows by name. The first one is without a fault."""


def found_of(lie: Lie, folder: Path) -> Found:
    """Return the result of a row: the demo's recording, changed, written as files and solved without options."""
    capture = demo_capture(FRAMES, FPS)
    cameras, keypoints = capture.require_multiview()
    whole = Recording(keypoints.xy, keypoints.confidence, cameras, cameras.names)
    spoiled = lie.spoil(whole, np.random.default_rng(0))
    write_trial(
        folder / "trial", cameras=spoiled.cameras, people=[(spoiled.xy, spoiled.confidence)], names=spoiled.names,
        calibrated=spoiled.cameras.names, config=f"[project]\nframe_rate = {lie.fps:g}\n",
    )  # fmt: skip
    out, report = folder / "motion.npz", folder / "report.html"
    words = ["solve", str(folder / "trial"), "--out", str(out), "--report", str(report), *lie.words]
    try:
        outcome = function_of("solve")(parse(words), silent)
    except MocapError as error:
        return Found(True, named=(error.code,), missing=_lacking_error(error), says=error.message)
    joints = np.asarray(capture.truth["joints"])
    if lie.held is not None:
        joints = np.repeat(joints[lie.held : lie.held + 1], FRAMES, axis=0)
    if lie.order is not None:
        joints = joints[list(lie.order)]
    motion = read_motion(out)
    found = [item for item in read_diagnostics(outcome.data["diagnostics"]) if item.severity != "note"]
    notes = [item for item in read_diagnostics(outcome.data["diagnostics"]) if item.severity == "note"]
    page = html.unescape(report.read_text("utf-8"))
    missing = _lacking(outcome, page, found, motion.fps)
    named = tuple(dict.fromkeys(item.code for item in (*found, *notes)))
    says = sentence(found[0], motion.fps) if found else ""
    stated = _states_length(outcome, page, motion.fps), _states_size(outcome, page)
    return Found(False, error_mm(motion.joints, joints), named, missing, says, *stated)


def _states_length(outcome: Outcome, page: str, fps: float) -> bool:
    """Return whether console, report and JSON state the take's seconds, its rate and the rate's origin."""
    seconds, origin = FRAMES / fps, f"The frame rate is {fps:g} fps, as "
    console = (
        f"{FRAMES} frames, {seconds:.1f} s at {fps:g} frames per second" in outcome.text and origin in outcome.text
    )
    report = f"{FRAMES} frames at {fps:g} fps ({seconds:.1f} s)" in page and origin in page
    codes = [item.code for item in read_diagnostics(outcome.data["diagnostics"])]
    return console and report and outcome.data["duration_s"] == round(seconds, 3) and "frame_rate_read" in codes


def _states_size(outcome: Outcome, page: str) -> bool:
    """Return whether console, report and JSON state the person's height."""
    diagnostics = read_diagnostics(outcome.data["diagnostics"])
    tall = [item.values["stature"] for item in diagnostics if item.code == "person_triangulated"]
    texts = [f"the person is about {stature:.2f} m tall" for stature in tall]
    return bool(texts) and all(text in place for text in texts for place in (outcome.text, page))


def _lacking(outcome: Outcome, page: str, found: list[Diagnostic], fps: float) -> tuple[str, ...]:
    people, programs, errors = io.StringIO(), io.StringIO(), io.StringIO()
    for out, as_json in ((people, False), (programs, True)):
        Report(out, errors, as_json=as_json).result(outcome.data, outcome.text, outcome.summary)
    texts = {"console": people.getvalue() + errors.getvalue(), "report": page, "JSON": programs.getvalue()}
    return tuple(
        f"{item.code} in {place}"
        for item in found
        for place, text in texts.items()
        if (item.code if place == "JSON" else sentence(item, fps)[:_BEGIN]) not in text
    )


def _lacking_error(error: MocapError) -> tuple[str, ...]:
    people, programs, errors = io.StringIO(), io.StringIO(), io.StringIO()
    for out, as_json in ((people, False), (programs, True)):
        Report(out, errors, as_json=as_json).error(error)
    texts = {"console": errors.getvalue(), "JSON": programs.getvalue()}
    return tuple(place for place, text in texts.items() if error.message[:_BEGIN] not in text)
