"""The faults of a recording in sentences, each with what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from solver_backend.types import Fault, FaultKind, Motion, Remedy

LONGEST_LIST = 6
"""Ranges of frames named one by one; the rest is counted."""

_DONE = {
    Remedy.REPAIRED: "put right",
    Remedy.EXCLUDED: "the view is not used there",
    Remedy.REPORTED: "nothing was changed",
    Remedy.BRIDGED: "bridged",
}


@dataclass(frozen=True)
class FaultText:
    """One sentence about faults of one kind in one camera."""

    what: str
    advice: str
    bad: bool
    """The solve suffers; otherwise it was repaired."""


def faults_of(motion: Motion) -> list[Fault]:
    """Return the faults that a solve wrote down."""
    return [Fault.from_dict(values) for values in motion.provenance.get("findings", ())]


def fault_texts(faults: Sequence[Fault], fps: float) -> list[FaultText]:
    """Return a sentence for each camera and kind of fault, in the order of their first frames."""
    groups: dict[tuple[FaultKind, str, str, Remedy], list[Fault]] = {}
    for fault in faults:
        groups.setdefault((fault.kind, fault.camera, fault.detail, fault.remedy), []).append(fault)
    return [_text(group, fps) for group in groups.values()]


def frames_text(runs: Sequence[tuple[int, int]], fps: float) -> str:
    """Return ranges of frames as text, the longest ones by name."""
    longest = sorted(sorted(runs, key=lambda run: run[0] - run[1])[:LONGEST_LIST])
    named = [f"frame {a}" if a == b else f"frames {a}-{b} ({(b - a + 1) / fps:.2f} s)" for a, b in longest]
    more = f" and {len(runs) - len(longest)} shorter ones" if len(runs) > len(longest) else ""
    return ", ".join(named) + more


def _text(group: list[Fault], fps: float) -> FaultText:
    fault = group[0]
    where = frames_text([(f.first, f.last) for f in group], fps)
    words = _WORDS[fault.kind]
    named = fault.camera
    if fault.kind is FaultKind.DELAY_UNKNOWN:
        named = f"camera {fault.camera}" if fault.camera else "any camera"
    what = words.what.format(camera=named, detail=fault.detail, size=abs(fault.figure))
    if fault.kind is FaultKind.UNSYNCHRONISED:
        what += " early" if fault.figure < 0 else " late"
    return FaultText(f"{what} in {where}: {_DONE[fault.remedy]}.", words.advice, fault.remedy is not Remedy.REPAIRED)


@dataclass(frozen=True)
class _Words:
    what: str
    advice: str


_WORDS: dict[FaultKind, _Words] = {
    FaultKind.LIMBS_EXCHANGED: _Words(
        "Camera {camera}: left and right {detail} are exchanged",
        "Nothing to do; compare with the footage if the limbs look wrong there.",
    ),
    FaultKind.SIDES_EXCHANGED: _Words(
        "Camera {camera}: left and right are exchanged", "Check the names of the keypoints in this view's files."
    ),
    FaultKind.IMAGE_MIRRORED: _Words(
        "Camera {camera}: the image is mirrored", "Turn off mirroring in the camera or in what records it."
    ),
    FaultKind.NAMES_EXCHANGED: _Words(
        "Camera {camera} and camera {detail} are exchanged",
        "Give their folders of detections, or their calibrations, each other's names.",
    ),
    FaultKind.CAMERA_TURNED: _Words(
        "Camera {camera} is turned by {size:.1f}° against its calibration",
        "It was bumped or moved: calibrate it anew.",
    ),
    FaultKind.UNSYNCHRONISED: _Words(
        "Camera {camera} runs {size:.1f} frames",
        "Its detections were moved in time; synchronise the recordings to use every frame.",
    ),
    FaultKind.RATE_DIFFERS: _Words(
        "Camera {camera} runs at another rate, by {size:.1f} frames over the take",
        "Its detections were moved in time; record, or convert, all cameras at one rate.",
    ),
    FaultKind.FRAMES_REPEATED: _Words(
        "Camera {camera} repeats frames, {size:.0f} % of its own",
        "Its video was converted to a higher rate, or the detector skips frames: use each camera's own rate.",
    ),
    FaultKind.FRAMES_SKIPPED: _Words(
        "Every other frame or so, {size:.0f} %, has no detections in any view",
        "The detector looked at some frames alone: let it look at all, or convert the videos to the rate it looked at.",
    ),
    FaultKind.DELAY_UNKNOWN: _Words(
        "Whether {camera} is in step with the others cannot be told, for too little moves",
        "Nothing to do if the recordings are synchronised; else let the person wave or step before all cameras.",
    ),
    FaultKind.CONTRADICTS: _Words(
        "Camera {camera} shows something else than the others",
        "Look at its footage there: somebody else, a mirror, or a bump.",
    ),
    FaultKind.PERSON_AWAY: _Words(
        "No two cameras see the person", "The pose is bridged from its neighbours; animate the stretch by hand."
    ),
    FaultKind.MARKERS_EXCHANGED: _Words(
        "The markers {detail} have each other's labels", "Nothing to do; correct the labels where the take is kept."
    ),
    FaultKind.MARKER_GHOST: _Words(
        "The marker {detail} is recorded where it cannot be", "Look at it there: a reflection, or a wrong label."
    ),
    FaultKind.MARKER_STILL: _Words(
        "The marker {detail} stands still while the person moves", "It fell off, or the recording repeats it."
    ),
}
