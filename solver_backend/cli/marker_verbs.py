"""Run the marker verbs: label a take, write markers, and draw a layout."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solver_backend.cli.outcome import Outcome, rows, sentences
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import CommandLineInvalid, MotionInvalid
from solver_backend.exchange.outputs import atomic_output, write_text
from solver_backend.exchange.progress import Progress

if TYPE_CHECKING:
    from solver_backend.labelling.label_take import LabelledTake
    from solver_backend.types import Capture

CONTENTS = {"cleaned": "cleaned_markers", "solved": "markers"}
"""Arrays in a motion file: recorded markers with gaps filled and swaps corrected, or markers on the solved body."""


def label(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Label the points of a marker take, and write markers or a capture."""
    from solver_backend.cli.arguments import loaded
    from solver_backend.exchange.errors import NoDetections
    from solver_backend.fitters.label_after import labelled_as_person
    from solver_backend.fitters.label_first import labelled_capture, named_in, named_points
    from solver_backend.io.native.motion_file import read_subject
    from solver_backend.io.native.user_labels_file import read_user_labels
    from solver_backend.labelling.position_network import chosen_network
    from solver_backend.report.labelling import labelling_html

    capture = loaded(args, progress)
    if capture.markers is None:
        raise NoDetections("The capture has no markers to label.", where=capture.name, hint="Choose a C3D or TRC file.")
    if args.like is not None:
        return _label_like(args, capture, progress)
    user_labels = {} if args.labels is None else read_user_labels(args.labels, capture.markers)
    network = chosen_network(args.network or "")
    labelled, take = labelled_capture(capture, progress, user_labels=user_labels, network=network, always=True)
    assert take is not None
    if args.subject is not None:
        kept = {*named_points(capture.markers).values(), *user_labels.values()}
        labelled = labelled_as_person(labelled, read_subject(args.subject), progress=progress, kept=kept)
    assert labelled.markers is not None
    if args.report is not None:
        write_text(args.report, labelling_html(capture.name, take, labelled.markers.fps), overwrite=args.overwrite)
    _write(args.out, labelled, overwrite=args.overwrite)
    data = {"report": None if args.report is None else str(args.report), **summary(take)}
    new = [item for item in labelled.problems if item not in capture.problems]
    of_person = sentences([item for item in labelled.notes if item.code == "points_named_of_person"])
    lines = [sentence(named_in(take)), *of_person, *rows("warning", *new)]
    return Outcome("\n".join(lines), {**data, "of_person": of_person, "problems": sentences(new)})


def _label_like(args: argparse.Namespace, capture: Capture, progress: Progress) -> Outcome:
    if args.labels is not None or args.report is not None or args.subject is not None:
        raise CommandLineInvalid("--like cannot be combined with --labels, --report or --subject.", where="--like")
    from solver_backend.fitters.label_after import labelled_like
    from solver_backend.io.load import load_capture

    labelled, _ = labelled_like(capture, load_capture(args.like), progress)
    _write(args.out, labelled, overwrite=args.overwrite)
    problems = sentences([item for item in labelled.problems if item not in capture.problems])
    return Outcome(sentence(labelled.notes[-1]), {"like": str(args.like), "problems": problems})


def _write(path: Path, labelled: Capture, *, overwrite: bool) -> None:
    from solver_backend.io.markers.read import write_markers
    from solver_backend.io.native.capture_file import write_capture

    assert labelled.markers is not None
    if path.suffix.lower() == ".npz":
        write_capture(path, labelled, overwrite=overwrite)
    else:
        write_markers(path, labelled.markers, overwrite=overwrite)


def summary(take: LabelledTake) -> dict[str, object]:
    """Return statistics about a labelled take as JSON values: label percentages, and each tracklet's label."""
    import numpy as np

    from solver_backend.labelling.outputs import GHOST, MARKERS

    labels = take.labels[np.isfinite(take.confidence)]
    shares = {"named": (labels >= 0) & (labels < GHOST), "none": labels == GHOST, "unknown": labels < 0}
    t = take.tracklets
    stretches = [
        {
            "point": int(t.column[i]),
            "first": int(t.first[i]),
            "last": int(t.last[i]),
            "label": None if k < 0 else "" if k == GHOST else MARKERS[k],
            "confidence": round(float(take.stretch_confidence[i]), 4),
        }
        for i, k in enumerate(take.stretch_label.tolist())
    ]
    percent = {f"{name}_percent": round(100.0 * float(share.mean()), 2) for name, share in shares.items()}
    return {**percent, "stretches": stretches}


def export_markers(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write the markers of a motion, in the format that the file suffix indicates."""
    from solver_backend.io.markers.read import write_markers
    from solver_backend.types import MarkerCloud

    positions, labels, fps = _markers(args.motion, args.contents)
    cloud = MarkerCloud(positions, fps, labels)
    progress("Writing the markers", 0, 1)
    write_markers(args.out, cloud, overwrite=args.overwrite)
    progress("Writing the markers", 1, 1)
    frames, markers = positions.shape[:2]
    data = {"frames": frames, "fps": fps, "markers": markers, "contents": args.contents}
    return Outcome(f"{frames} frames of {markers} {args.contents} markers at {fps:g} fps", data)


def marker_places(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Draw the marker positions of a layout on the body, and write the image."""
    from solver_backend.body.files.choices import load_chosen_body
    from solver_backend.body.marker_layouts import load_layouts
    from solver_backend.io.png import png_bytes
    from solver_backend.synthesis.studio.places_picture import places_picture

    file = load_layouts()
    layouts = {**file.layouts, **file.label_sets}
    places = tuple(dict.fromkeys(p for label in layouts[args.layout] if (p := file.place_of(label)) is not None))
    picture = places_picture(load_chosen_body(args.body), places)
    with atomic_output(args.out, overwrite=args.overwrite) as temporary:
        temporary.write_bytes(png_bytes(picture))
    data = {"layout": args.layout, "markers": len(places), "size": [*picture.shape[1::-1]]}
    return Outcome(f"{len(places)} markers of {args.layout}", data)


def _markers(path: Path, contents: str) -> tuple[Any, tuple[str, ...], float]:
    """Return marker positions (F, M, 3) in metres, labels and frame rate in Hz.

    Raises:
        MotionInvalid: the motion was not solved from markers, or does not contain the requested markers.
    """
    from solver_backend.exchange.motion_file import FORMAT, STORED, VERSION
    from solver_backend.exchange.plausible import require_rate
    from solver_backend.exchange.schema import read_fields

    key = CONTENTS[contents]
    fields = read_fields(path, tuple(dict.fromkeys((*STORED, *CONTENTS.values()))))
    fields.require_format(FORMAT, VERSION)
    labels = fields.texts("marker_labels")
    if not labels:
        hint = "Solve a recording that has markers."
        raise MotionInvalid("The motion was not solved from markers.", where=str(path), hint=hint)
    if key not in fields:
        other = next((name for name, array in CONTENTS.items() if array in fields), None)
        hint = "Solve the take again" + (f", or export the {other} ones." if other else ".")
        raise MotionInvalid(f"The motion contains no {contents} markers.", where=str(path), hint=hint)
    frames = (*fields.array("poses").shape, 0)[0]
    rate = fields.first_number("mocap_framerate", MotionInvalid)
    require_rate(rate, MotionInvalid, str(path))
    return fields.shaped(key, (frames, len(labels), 3), MotionInvalid), labels, rate
