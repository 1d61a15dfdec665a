"""Verbs that look at captures, solve them, detect keypoints in videos and label markers."""

from __future__ import annotations

from dataclasses import replace

from .. import verb_results as results
from ..marker_formats import FORMAT_NAMES, file_names
from ..setting import REQUIRED, Choice
from ..verb import Verb, flag, option, output, place, values
from ..video_settings import ROWS as VIDEO_ROWS
from .shared import (
    BODY,
    CAPTURE,
    DETECTOR,
    FOOTAGE,
    LABELS,
    MOTION,
    OVERWRITE,
    READING,
    SOLVE_ROWS,
    SOLVING,
    TAKE,
    TLS,
    WORLD,
    marker_endings,
    report,
)

_LOOK, _SOLVE, _VIDEOS, _MARKERS = "Look at a capture", "Solve", "Videos", "Markers"
_STEPS = values("detect", "sync", "calibrate", "capture", "solve")
_OF_VIDEOS = {name: replace(row, of_class=False) for name, row in VIDEO_ROWS.items()}

VERBS = (
    Verb(
        "info", _LOOK, "solve", "report what a capture holds and what is wrong with it", "info trial", "verbs:info",
        (CAPTURE, report("the capture"), *READING, OVERWRITE),
        results.CaptureSummary,
    ),
    Verb(
        "people", _LOOK, "solve", "list the people that two or more views see", "people trial", "verbs:people",
        (CAPTURE, *READING),
    ),
    Verb(
        "convert", _LOOK, "solve", "write any capture as one file", "convert trial --out trial.npz", "verbs:convert",
        (
            place("path", "capture", "CAPTURE", "Capture, or session of trials"),
            output("CAPTURE.npz", "Capture to write; a folder for a session", is_output=False),
            *READING, OVERWRITE,
        ),
        results.CaptureResult,
    ),
    Verb(
        "demo-capture", _LOOK, "solve", "write the embedded synthetic capture", "demo-capture --out demo.npz",
        "verbs:demo_capture",
        (
            output("CAPTURE.npz", "Capture to write"),
            flag("markers", "Optical markers instead of keypoints in four views"),
            OVERWRITE,
        ),
        results.CaptureResult,
    ),
    Verb(
        "solve", _SOLVE, "solve", "solve a capture and write the motion (--person all: everybody)",
        "solve trial --out motion.npz --report report.html", "solve_verb:solve",
        (
            place("path", "capture", "CAPTURE", "Capture, or session of trials", None),
            output("MOTION.npz", "Motion file to write; a folder for a session", None, is_output=False),
            flag("strict", "Treat warnings as errors: exit code 3, nothing is written"),
            replace(report("the solve"), is_output=False),
            option("path", "subject", "SUBJECT.npz", "Person of the markers, see calibrate"),
            LABELS,
            option("path", "start", "MOTION.npz", "Earlier motion of these frames to start from, such as that of one "
                   "camera"),
            option("path", "resolve", "MOTION.npz", "Solve --frames of an earlier motion again"),
            option("text", "scheduler", "ADDRESS", "Spread a long solve over the workers of a Dask scheduler"),
            TLS,
            option("path", "job", "JOB.json", "Read the arguments from a job file", repeated=True),
            *SOLVING, *READING, OVERWRITE,
        ),
        results.SolveResult,
    ),
    Verb(
        "from-videos", _SOLVE, "solve",
        "solve a folder of videos, or one video: detect, synchronise, calibrate, solve",
        "from-videos footage --dry-run", "video_verbs:from_videos",
        (
            place("path", "folder", "FOLDER|VIDEO", "Folder with takes in 'videos' and boards in 'calibration', or one "
                  "video"),
            output("DIR", "Folder of the results; FOLDER/mocap or VIDEO_mocap if left out", None, "folder",
                   is_output=False),
            option("text", "take", "NAME", "Only this take"),
            flag("dry_run", "Report what would be done, and do nothing"),
            option("choice", "until", "", "Step after which to stop", "solve", choices=_STEPS),
            option("choice", "redo", "", "Do this step again", (), choices=_STEPS, repeated=True),
            _OF_VIDEOS["cameras"],
            replace(_OF_VIDEOS["board"], default=None),
            option("path", "lenses", "FILE", VIDEO_ROWS["lenses"].description),
            _OF_VIDEOS["focal"],
            option("path", "hand_model", "MODEL.tflite", "Also find hands where the body has its wrists, by "
                   "hand_landmark_full.tflite, and solve the fingers"),
            option("path", "hand_python", "PATH", "The Python that has ai-edge-litert; that of --python if left out"),
            *WORLD, *(row for row in SOLVING if row.name != "layout"), *DETECTOR, *FOOTAGE, OVERWRITE,
        ),
        results.VideosResult,
    ),
    Verb(
        "evaluate", _SOLVE, "solve", "compare a motion with the ground truth in its capture",
        "evaluate demo.npz motion.npz", "verbs:evaluate",
        (CAPTURE, place("path", "motion", "MOTION.npz", "Motion that was solved from it")),
    ),
    Verb("bodies", _SOLVE, "solve", "list the bodies that can be chosen by name", "bodies", "verbs:bodies"),
    Verb(
        "detect", _VIDEOS, "solve", "find keypoints in videos and write a capture",
        "detect cam01.mp4 cam02.mp4 --out capture.npz", "video_verbs:detect",
        (
            place("path", "videos", "VIDEO", "One video for each camera, or a folder of them", many=True),
            output("CAPTURE.npz", "Capture to write"),
            option("path", "calibration", "FILE", "Calibration of the cameras; the capture has none if left out"),
            option("folder", "work", "DIR", "Folder that keeps each video's detections; beside --out if left out"),
            option("folder", "preview", "DIR", "Also write videos with the keypoints drawn over them"),
            *WORLD, *DETECTOR, *FOOTAGE, OVERWRITE,
        ),
    ),
    Verb(
        "detector-noise", _VIDEOS, "solve", "measure a detector's noise at each confidence",
        "detector-noise capture.npz --out noise.json", "video_verbs:detector_noise",
        (
            place("path", "captures", "CAPTURE", "Captures of known cameras", many=True),
            option("text", "detector_name", "NAME", "Name of the detector; read from the captures if left out"),
            output("NOISE.json", "Noise map to write"),
            OVERWRITE,
        ),
    ),
    Verb(
        "find-hands", _VIDEOS, "hands", "find the hands of a capture's person in its footage",
        "find-hands trial --model hand_landmark_full.tflite --python litert/bin/python --out hands.npz",
        "video_verbs:find_hands",
        (
            place("path", "capture", "CAPTURE", "Calibrated capture with keypoints and footage"),
            option("path", "model", "MODEL.tflite", "MediaPipe's hand_landmark_full.tflite", REQUIRED),
            option("path", "python", "PATH", "The Python that has ai-edge-litert"),
            output("CAPTURE.npz", "Capture to write"),
            OVERWRITE,
        ),
    ),
    Verb(
        "label", _MARKERS, "markers", "label the unlabelled points of a marker take",
        "label take.c3d --out labelled.c3d", "marker_verbs:label",
        (
            TAKE,
            output(file_names("LABELLED", "LABELLED.npz"), "File to write", endings=marker_endings(".npz")),
            report("the labels"),
            LABELS,
            option("path", "subject", "SUBJECT.npz", "Person of the markers, see calibrate: their labels are used, "
                   "also those of markers outside the network's places"),
            option("path", "like", "LABELLED.c3d", "Name the points after a labelled take of the same person and "
                   "marker layout"),
            *READING, OVERWRITE,
        ),
    ),
    Verb(
        "calibrate", _MARKERS, "markers", "learn a person's shape and marker positions from marker takes",
        "calibrate range_of_motion.c3d --out subject.npz", "verbs:calibrate",
        (
            place("path", "captures", "TAKE", "One or several takes of one person", many=True),
            output("SUBJECT.npz", "Calibrated person to write"),
            SOLVE_ROWS["body"], SOLVE_ROWS["layout"], *READING, OVERWRITE,
        ),
        results.PersonResult,
    ),
    Verb(
        "layout", _MARKERS, "markers", "write how each marker label is read, as a file to edit",
        "layout take.c3d --out layout.json", "verbs:layout",
        (TAKE, output("LAYOUT.json", "File to write, to be edited"), *READING, OVERWRITE),
    ),
    Verb(
        "marker-places", _MARKERS, "markers", "draw where a layout's markers sit on the body",
        "marker-places --out places.png", "marker_verbs:marker_places",
        (
            option("text", "layout", "NAME", "Marker layout", "MANIFOLD_53"),
            BODY,
            output("PICTURE.png", "Picture to write", endings=(".png",)),
            OVERWRITE,
        ),
    ),
    Verb(
        "export-markers", _MARKERS, "markers", f"write a motion's markers as {FORMAT_NAMES}",
        "export-markers motion.npz --out cleaned.c3d", "marker_verbs:export_markers",
        (
            MOTION,
            output(file_names("TAKE"), "File to write", endings=marker_endings()),
            option(
                "choice", "contents", "", "Which markers", "cleaned",
                choices=(
                    Choice("cleaned", "Cleaned", "As recorded, gaps filled and swaps undone"),
                    Choice("solved", "Solved", "Where the body has them"),
                ),
            ),
            OVERWRITE,
        ),
        results.MarkersResult,
    ),
    Verb(
        "export-props", _MARKERS, "markers", "write a motion's props as JSON",
        "export-props motion.npz --out props.json", "prop_verbs:export_props",
        (MOTION, output("PROPS.json", "File to write", endings=(".json",)), OVERWRITE),
    ),
)  # fmt: skip
"""In the order in which help lists them."""
