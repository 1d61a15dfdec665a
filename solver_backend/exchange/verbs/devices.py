"""Verbs about cameras and sensors: calibrate them, record with them, and pose people live."""

from __future__ import annotations

from dataclasses import replace

from .. import verb_results as results
from ..marker_formats import file_names
from ..setting import REQUIRED
from ..verb import Verb, flag, option, output, place, values
from .shared import (
    BOARD_WORDS,
    CAPTURE,
    DETECTOR,
    EMPTY,
    FORMAT,
    LENSES,
    LINES,
    OAK,
    OAK_RECORDING,
    OVERWRITE,
    READING,
    REPEAT,
    SECONDS,
    SEND,
    SENSOR_CHAIN,
    SENSOR_FOLDER,
    SUBJECT,
    WITH_POINTS,
    WORLD,
    marker_endings,
    report,
)

_CAMERAS, _SENSORS, _LIVE = "Cameras", "Sensors", "Live"
_TOGETHER = "--from together: sources that adjust a CALIBRATION together"
_CALIBRATION = output("CALIBRATION.toml", "File to write", is_output=False)

VERBS = (
    Verb(
        "check-cameras", _CAMERAS, "cameras", "check that a capture's calibration fits its detections",
        "check-cameras trial", "camera_verbs:check_cameras", (CAPTURE, *READING), results.CheckResult,
    ),
    Verb(
        "fit-cameras", _CAMERAS, "cameras", "write a capture's calibration corrected, scaled and levelled",
        "fit-cameras trial --stature 1.78 --out calibration.toml", "camera_verbs:fit_cameras",
        (CAPTURE, _CALIBRATION, FORMAT, *READING, OVERWRITE),
    ),
    Verb(
        "refine-cameras", _CAMERAS, "cameras", "correct a calibration from the people in the capture",
        "refine-cameras trial --out refined.npz", "verbs:refine_cameras",
        (CAPTURE, output("CAPTURE.npz", "Capture with corrected cameras"), *READING, OVERWRITE),
        results.RefineResult,
    ),
    Verb(
        "calibrate-cameras", _CAMERAS, "cameras", "calibrate cameras and write the calibration",
        "calibrate-cameras boards --from board --board charuco:8x11:24mm --out calibration.toml",
        "camera_verbs:calibrate_cameras",
        (
            place("path", "source", "FOLDER|CAPTURE|CLICKS.csv|CALIBRATION", "Footage of a board, capture, table of "
                  "clicked points or calibration, as --from needs it"),
            option("choice", "method", "", "How to find the camera positions", "board", option="--from",
                   choices=values("board", "person", "points", "refine", "together", "lenses")),
            _CALIBRATION, FORMAT,
            option("text", "board", "BOARD", BOARD_WORDS),
            option("text", "lens", "MODEL", "Lens models to choose from; all if left out", repeated=True),
            LENSES,
            option("path", "keep_lenses", "LENSES.json", "Add the lenses found to this library"),
            option("folder", "coverage", "FOLDER", "Write a picture of where the board was seen"),
            option("whole", "origin", "FRAME", "Frame at which the board lies on the floor"),
            flag("refine_lenses", "Also refine the lenses; of a person, the focal lengths"),
            option("text", "length", "KEYPOINT KEYPOINT METRES", "Known distance of two keypoints, instead of the "
                   "stature", count=3),
            option("folder", "footage", "FOLDER", "Footage of --board, seen by several cameras at once",
                   group=_TOGETHER),
            option("path", "take", "CAPTURE", "Synchronised take of a person", group=_TOGETHER),
            option("path", "clicks", "CLICKS.csv", "Points clicked in pictures, some with known places",
                   group=_TOGETHER),
            option("number", "hold", "MM", "Accuracy of the calibration, which then counts as a source",
                   group=_TOGETHER),
            *READING, OVERWRITE,
        ),
    ),
    Verb(
        "board", _CAMERAS, "cameras", "write a calibration board to print", "board charuco:5x7:35mm --out board.pdf",
        "camera_verbs:board",
        (
            place("text", "board", "BOARD", BOARD_WORDS),
            output("BOARD.pdf|BOARD.svg", "File to print", endings=(".pdf", ".svg")),
            option("text", "paper", "SIZE", "A4, A3, A2, A1, A0, letter, tabloid or fit", "fit"),
            OVERWRITE,
        ),
    ),
    Verb(
        "oaks", _SENSORS, "sensors", "list the OAK cameras that are plugged in or on the network", "oaks",
        "oak_verbs:oaks", (), results.OaksResult,
    ),
    Verb(
        "record-oak", _SENSORS, "sensors", "record infrared and depth of OAK cameras, for markers and wands",
        "record-oak take --oak ID1=front --oak ID2=left --sync wire --seconds 30", "oak_verbs:record_oak",
        (
            *OAK_RECORDING, *OAK,
            option("path", "calibration", "FILE", "Lenses; those stored in the devices if left out"),
            OVERWRITE,
        ),
    ),
    Verb(
        "record-colour", _SENSORS, "sensors", "record synchronised colour video of OAK cameras, for from-videos",
        "record-colour take --oak ID1=front --oak ID2=left --seconds 20", "oak_verbs:record_colour",
        (*OAK_RECORDING, OAK[0], flag("wire", "The cameras are joined by a sync wire")),
    ),
    Verb(
        "calibrate-wand", _SENSORS, "sensors", "calibrate sensors from a recording of a waved wand",
        "calibrate-wand wand --out sensors.toml", "wand_verbs:calibrate_wand",
        (
            place("folder", "folder", "FOLDER", "One table for each sensor, or a recording of sensors"),
            _CALIBRATION, FORMAT, report("the calibration"), LENSES,
            option("number", "wand", "FIRST SECOND", "Metres from light to light of a wand with three lights; leave "
                   "out for a marker with depth", count=2),
            flag("trigger", "All sensors share a trigger wire, so their clocks agree"),
            option("number", "interleave", "MICROSECONDS", "Delay of each sensor's exposure after the one before; 160 "
                   "for time-of-flight sensors", 0.0),
            EMPTY,
            flag("every_sensor", "Use only moments at which all sensors see the wand"),
            option("folder", "gamma", "FOLDER", "Recording of the Γ on the floor by the same sensors"),
            option("number", "gamma_lengths", "LONG SHORT", "Edges of the Γ in metres", (0.6, 0.4), count=2),
            option("number", "gamma_height", "METRES", "Height of the Γ's marker centres above the floor", 0.007),
            OVERWRITE,
        ),
        results.SensorsResult,
    ),
    Verb(
        "markers-from-sensors", _SENSORS, "sensors", "find markers in infrared and depth recordings",
        "markers-from-sensors take --out cloud.c3d", "sensor_verbs:markers_from_sensors",
        (
            SENSOR_FOLDER,
            output(file_names("CLOUD", "CAPTURE.npz"), "File to write", endings=marker_endings(".npz")),
            *SENSOR_CHAIN, OVERWRITE,
        ),
    ),
    Verb(
        "sensors-record", _SENSORS, "sensors", "copy a sensor recording to a folder", "sensors-record take --out copy",
        "sensor_verbs:sensors_record",
        (SENSOR_FOLDER, output("FOLDER", "Folder to write", kind="folder", is_output=False), *SENSOR_CHAIN, OVERWRITE),
    ),
    Verb(
        "sensors-live", _SENSORS, "sensors", "stream points or poses from sensors, one line per frame",
        "sensors-live take --poses", "sensors_live_verb:sensors_live",
        (
            replace(SENSOR_FOLDER, required=False),
            option("text", "oak", "ID[=NAME]", "A camera, instead of FOLDER", repeated=True),
            *OAK,
            flag("poses", "Fit a body to the points, and write lines as live does"),
            replace(SEND, description=f"With --poses: a{SEND.description[1:]}"),
            flag("wand", "Report the wand's coverage, and where to wave it next"),
            WITH_POINTS, SUBJECT, LINES,
            option("folder", "record", "FOLDER", "Also record the sensors' frames"),
            option("path", "solve", "MOTION.npz", "Solve the recording with the bundle afterwards", is_output=True),
            REPEAT, replace(SECONDS, high=3600), *SENSOR_CHAIN, OVERWRITE,
        ),
    ),
    Verb(
        "live", _LIVE, "live", "stream poses from marker points or a motion, one line per frame",
        "live take.c3d --lines poses.jsonl --send vmc://", "live_verb:live",
        (
            place("text", "source", "SOURCE", "Take or motion to replay at its own rate, - for lines on stdin, "
                  "vmc://:PORT for poses that come there, livelink:// or ifacialmocap://PHONE for a face"),
            flag("fast", "Run as fast as possible, and drop no frame"),
            REPEAT, LINES, SEND,
            option("path", "record", "TAKE.c3d|MOTION.npz|FACE.csv", "Also record the points, to be solved afterwards, "
                   "the poses that come by vmc://, or the face", is_output=True),
            SUBJECT, WITH_POINTS, *READING, OVERWRITE,
        ),
    ),
    Verb(
        "camera-live", _LIVE, "live", "stream poses from two to four cameras or videos, one line per moment",
        "camera-live cam01=webcam:0 cam02=webcam:1 --calibration calibration.toml --record take.npz",
        "camera_live_verb:camera_live",
        (
            place("text", "sources", "[NAME=]SOURCE", "Two to four of: a video to replay, webcam:NUMBER, oak:ID; "
                  "NAME=SOURCE gives the camera's name in the calibration", many=True),
            option("path", "calibration", "FILE", "Calibration of the cameras", REQUIRED),
            option("text", "up_axis", "AXIS", "Axis of the calibration that points up, if not z"),
            option("number", "rate", "HZ", "Largest number of poses per second", 30.0, low=1, high=240),
            REPEAT, SECONDS, SUBJECT, SEND, LINES, WITH_POINTS,
            option("path", "record", "TAKE.npz", "Also record keypoints and times as a capture, and the poses as "
                   "TAKE_live.npz, for solve --start", is_output=True, endings=(".npz",)),
            *WORLD, *DETECTOR, OVERWRITE,
        ),
    ),
)  # fmt: skip
"""In the order in which help lists them."""
