"""The table of verbs: the parser, the help by task, docs/reference/command-line.md and what runs come from it."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from solver_backend.cli import (
    camera_verbs,
    capture_arguments,
    glove_verbs,
    live_arguments,
    marker_verbs,
    motion_verbs,
    network_verbs,
    oak_verbs,
    pose_arguments,
    prop_verbs,
    sensor_verbs,
    studio_verbs,
    video_arguments,
    wand_verbs,
)
from solver_backend.exchange.marker_formats import FORMAT_NAMES

Shared = Literal["reading", "writing", "detector", "footage", "prior"]
"""Options that several verbs take: how captures are read, what is overwritten, the detector, how videos are read, the
prior's weights."""


@dataclass(frozen=True)
class Verb:
    """One verb: its line of help, what somebody would type, and where it is.

    ``module`` of this package has the function of the verb's name; it is imported when the verb runs, so that
    ``--help`` and a wrong command line are answered at once. ``add_arguments`` adds the verb's own arguments.
    """

    name: str
    help: str
    example: str
    module: str
    add_arguments: Callable[[argparse.ArgumentParser], None] | None
    shared: tuple[Shared, ...] = ()


# fmt: off
TASKS: dict[str, tuple[Verb, ...]] = {
    "Look at a capture": (
        Verb("info", "report what a capture holds and what is wrong with it", "info trial",
             "verbs", capture_arguments.info_arguments, ("reading", "writing")),
        Verb("people", "list the people that two or more views see", "people trial",
             "verbs", capture_arguments.people_arguments, ("reading",)),
        Verb("convert", "write any capture as one file", "convert trial --out trial.npz",
             "verbs", capture_arguments.convert_arguments, ("reading", "writing")),
        Verb("demo-capture", "write the embedded synthetic capture", "demo-capture --out demo.npz",
             "verbs", capture_arguments.demo_capture_arguments, ("writing",)),
    ),
    "Solve": (
        Verb("solve", "solve a capture and write the motion (--person all: everybody)",
             "solve trial --out motion.npz --report report.html",
             "solve_verb", capture_arguments.solve_arguments, ("reading", "writing")),
        Verb("from-videos", "solve a folder of videos, or one video: detect, synchronise, calibrate, solve",
             "from-videos footage --dry-run",
             "video_verbs", video_arguments.from_videos_arguments, ("detector", "footage", "writing")),
        Verb("evaluate", "compare a motion with the ground truth in its capture", "evaluate demo.npz motion.npz",
             "verbs", capture_arguments.evaluate_arguments),
        Verb("bodies", "list the bodies that can be chosen by name", "bodies",
             "verbs", None),
    ),
    "Videos": (
        Verb("detect", "find keypoints in videos and write a capture", "detect cam01.mp4 cam02.mp4 --out capture.npz",
             "video_verbs", video_arguments.detect_arguments, ("detector", "footage", "writing")),
        Verb("detector-noise", "measure a detector's noise at each confidence",
             "detector-noise capture.npz --out noise.json",
             "video_verbs", video_arguments.detector_noise_arguments, ("writing",)),
        Verb("find-hands", "find the hands of a capture's person in its footage",
             "find-hands trial --model hand_landmark_full.tflite --python litert/bin/python --out hands.npz",
             "video_verbs", video_arguments.find_hands_arguments, ("writing",)),
    ),
    "Markers": (
        Verb("label", "label the unlabelled points of a marker take", "label take.c3d --out labelled.c3d",
             "marker_verbs", marker_verbs.label_arguments, ("reading", "writing")),
        Verb("calibrate", "learn a person's shape and marker positions from marker takes",
             "calibrate range_of_motion.c3d --out subject.npz",
             "verbs", capture_arguments.calibrate_arguments, ("reading", "writing")),
        Verb("layout", "write how each marker label is read, as a file to edit", "layout take.c3d --out layout.json",
             "verbs", capture_arguments.layout_arguments, ("reading", "writing")),
        Verb("marker-places", "draw where a layout's markers sit on the body", "marker-places --out places.png",
             "marker_verbs", marker_verbs.marker_places_arguments, ("writing",)),
        Verb("export-markers", f"write a motion's markers as {FORMAT_NAMES}",
             "export-markers motion.npz --out cleaned.c3d", "marker_verbs",
             marker_verbs.export_markers_arguments, ("writing",)),
        Verb("export-props", "write a motion's props as JSON", "export-props motion.npz --out props.json",
             "prop_verbs", prop_verbs.export_props_arguments, ("writing",)),
    ),
    "Cameras": (
        Verb("check-cameras", "check that a capture's calibration fits its detections", "check-cameras trial",
             "camera_verbs", camera_verbs.check_cameras_arguments, ("reading",)),
        Verb("fit-cameras", "write a capture's calibration corrected, scaled and levelled",
             "fit-cameras trial --stature 1.78 --out calibration.toml",
             "camera_verbs", camera_verbs.fit_cameras_arguments, ("reading", "writing")),
        Verb("refine-cameras", "correct a calibration from the people in the capture",
             "refine-cameras trial --out refined.npz",
             "verbs", capture_arguments.refine_cameras_arguments, ("reading", "writing")),
        Verb("calibrate-cameras", "calibrate cameras and write the calibration",
             "calibrate-cameras boards --from board --board charuco:8x11:24mm --out calibration.toml",
             "camera_verbs", camera_verbs.calibrate_cameras_arguments, ("reading", "writing")),
        Verb("board", "write a calibration board to print", "board charuco:5x7:35mm --out board.pdf",
             "camera_verbs", camera_verbs.board_arguments, ("writing",)),
    ),
    "Sensors": (
        Verb("oaks", "list the OAK cameras that are plugged in or on the network", "oaks",
             "oak_verbs", None),
        Verb("record-oak", "record infrared and depth of OAK cameras, for markers and wands",
             "record-oak take --oak ID1=front --oak ID2=left --sync wire --seconds 30",
             "oak_verbs", oak_verbs.record_oak_arguments, ("writing",)),
        Verb("record-colour", "record synchronised colour video of OAK cameras, for from-videos",
             "record-colour take --oak ID1=front --oak ID2=left --seconds 20",
             "oak_verbs", oak_verbs.record_colour_arguments),
        Verb("calibrate-wand", "calibrate sensors from a recording of a waved wand",
             "calibrate-wand wand --out sensors.toml", "wand_verbs", wand_verbs.calibrate_wand_arguments, ("writing",)),
        Verb("markers-from-sensors", "find markers in infrared and depth recordings",
             "markers-from-sensors take --out cloud.c3d",
             "sensor_verbs", sensor_verbs.markers_from_sensors_arguments, ("writing",)),
        Verb("sensors-record", "copy a sensor recording to a folder", "sensors-record take --out copy",
             "sensor_verbs", sensor_verbs.sensors_record_arguments, ("writing",)),
        Verb("sensors-live", "stream points or poses from sensors, one line a frame", "sensors-live take --poses",
             "sensors_live_verb", live_arguments.sensors_live_arguments, ("writing",)),
    ),
    "Live": (
        Verb("live", "stream poses from marker points or a motion, one line a frame",
             "live take.c3d --lines poses.jsonl --send vmc://",
             "live_verb", live_arguments.live_arguments, ("reading", "writing")),
        Verb("camera-live", "stream poses from two to four cameras or videos, one line a moment",
             "camera-live cam01=webcam:0 cam02=webcam:1 --calibration calibration.toml --record take.npz",
             "camera_live_verb", live_arguments.camera_live_arguments, ("detector", "writing")),
    ),
    "Clean up and make motions": (
        Verb("motion", "convert a motion of another program to our body", "motion clip.bvh --out motion.npz",
             "motion_verbs", motion_verbs.motion_arguments, ("writing",)),
        Verb("add-hands", "add the fingers of gloves, or of another program, to a motion",
             "add-hands motion.npz gloves.bvh --out hands.npz", "glove_verbs", glove_verbs.add_hands_arguments,
             ("writing",)),
        Verb("denoise", "denoise a motion with Pose-NDF", "denoise motion.npz smooth.npz",
             "pose_verbs", pose_arguments.denoise_arguments, ("prior", "writing")),
        Verb("complete", "fill in unknown joint rotations with Pose-NDF",
             "complete motion.npz whole.npz --missing left_arm",
             "pose_verbs", pose_arguments.complete_arguments, ("prior", "writing")),
        Verb("interpolate", "generate the transition between two frames with Pose-NDF",
             "interpolate motion.npz filled.npz --frames 10 40 --count 30",
             "pose_verbs", pose_arguments.interpolate_arguments, ("prior", "writing")),
        Verb("fit-keypoints", "refit a motion to a capture's keypoints with Pose-NDF",
             "fit-keypoints trial motion.npz fitted.npz",
             "pose_verbs", pose_arguments.fit_keypoints_arguments, ("prior", "writing")),
        Verb("sample", "draw random plausible poses with Pose-NDF", "sample poses.npz --count 100",
             "pose_verbs", pose_arguments.sample_arguments, ("prior", "writing")),
    ),
    "Make data sets": (
        Verb("studio", "render synthetic captures with ground truth", "studio spec.json --out set",
             "studio_verbs", studio_verbs.studio_arguments),
        Verb("studio-benchmark", "solve a data set and compare with its ground truth", "studio-benchmark set",
             "studio_verbs", studio_verbs.studio_benchmark_arguments),
        Verb("studio-cameras", "map the expected error of camera layouts over the floor",
             "studio-cameras spec.json --out cameras.html", "studio_verbs", studio_verbs.studio_cameras_arguments,
             ("writing",)),
    ),
    "Train": (
        Verb("train", "train a pose prior or network, or resume from a checkpoint",
             "train sposer --data data --out trained", "verbs", capture_arguments.train_arguments),
        Verb("export-network", "write a landmark network as ONNX, from points to positions in metres",
             "export-network trained/landmarks_base_run --out base.onnx",
             "network_verbs", network_verbs.export_network_arguments, ("writing",)),
    ),
}
"""The verbs by task, in the order in which help lists them."""
# fmt: on
VERBS = {verb.name: verb for rows in TASKS.values() for verb in rows}
