"""Options that several verbs take, each declared once."""

from __future__ import annotations

from dataclasses import replace

from ..detectors import DETECTORS, MEDIAPIPE
from ..marker_formats import MARKER_FORMATS
from ..reading_settings import ROWS as READING_ROWS
from ..reading_settings import WorldSettings
from ..setting import POSITIVE, REQUIRED, Choice, Setting, settings_of_class
from ..solve_settings import SolveSettings
from ..verb import flag, option, place, values
from ..video_settings import ROWS as VIDEO_ROWS

SOLVE_ROWS = settings_of_class(SolveSettings)
JSON = flag("json", "Progress and result as JSON lines on standard output")
PARENT_PIPE = flag("parent_pipe", "End with standard input", hidden=True)
COMMON = (JSON, PARENT_PIPE, flag("verbose", "Log details to standard error", option="-v --verbose"))
"""Of every verb of the solver."""
OVERWRITE = flag("overwrite", "Replace existing results")
READING = (SOLVE_ROWS["sync"], *READING_ROWS.values())
"""How a capture is read."""
SOLVING = tuple(row for name, row in SOLVE_ROWS.items() if name != "sync")
"""How a capture is solved; ``sync`` is among the options of reading."""
WORLD = tuple(settings_of_class(WorldSettings).values())

CAPTURE = place("path", "capture", "CAPTURE", "Capture: a folder or file of keypoints or markers")
TAKE = place("path", "capture", "TAKE", "Recording of markers")
MOTION = place("path", "motion", "MOTION.npz", "Motion that was solved from markers")
SUBJECT = option("path", "subject", "SUBJECT.npz", "Calibrated person, see calibrate")
LABELS = option("path", "labels", "LABELS.json", "User-assigned labels; the solver never overrides them")
BODY = option("text", "body", "NAME|PATH", "Body to use, see bodies", "neutral")
LENSES = option("path", "lenses", "FILE", "A calibration or a lens library that has the lenses")
BOARD_WORDS = "KIND:COLUMNSxROWS:SQUARE, such as charuco:5x7:35mm, or a board.toml"
SEED = option("whole", "seed", "N", "The same seed gives the same result", 0)
TLS = option("folder", "tls", "FOLDER", "Certificates of a scheduler on another host")
SPEC = place("path", "description", "SPEC.json", "Description: motions, people, camera arrays and looks")
PLACES = flag("places", "Also map the camera arrays' errors over the floor")
BENCHMARK_SETTINGS = option("path", "settings", "SETTINGS.json", "Settings of the solves, as in a job file")

_FORMATS = "pose2sim, anipose, freemocap, caliscope, qualisys, opencv or colmap"
FORMAT = option("text", "format", "FORMAT", f"Format of the calibration: {_FORMATS}; chosen by the file's ending if "
                "left out")  # fmt: skip
EMPTY = option("folder", "empty", "FOLDER", "Recording of the empty scene, to mask lights")

DETECTOR = (
    option(
        "text", "detector", "NAME|MODEL",
        f"Name ({', '.join(DETECTORS)}) or file: RTMPose, RTMO, YOLO-pose or MoveNet (.onnx), MediaPipe (.tflite)",
        MEDIAPIPE,
    ),
    option("path", "detector_worker", "WORKER", "Your own detector: a program that runs in --python"),
    option("path", "python", "PATH", "The Python to run the detector in"),
    replace(VIDEO_ROWS["people"], of_class=False),
)  # fmt: skip
"""Which detector runs, and where."""
FOOTAGE = (
    option("number", "fps", "X", "Rate of folders of pictures; 30 if left out"),
    flag("hands", "Find hands too, and keep them with the detections"),
    option("whole", "jobs", "N", "Detectors that run at the same time; one for each core if left out", 0),
    replace(VIDEO_ROWS["clocks"], of_class=False, option="--sync"),
)
"""How recorded videos are read and detected."""

SENSOR_FOLDER = place("folder", "source", "FOLDER", "A recording, or a shot of the studio")
SENSOR_CHAIN = (
    option("path", "calibration", "CALIBRATION.toml", "Calibration to use instead of the folder's"),
    EMPTY,
    option(
        "choice", "clusters", "", "How seen points are joined", "test",
        choices=(
            Choice("test", "Covariance Test", "Those that their covariances allow"),
            Choice("radius", "Radius", "All within 1 cm, as published"),
        ),
    ),
    option(
        "choice", "pictures", "", "Format of recorded pictures", "raw",
        choices=(
            Choice("raw", "Raw", "1.5 MB per frame"),
            Choice("png", "PNG", "A third less, but much slower"),
        ),
    ),
)  # fmt: skip
"""How the frames of sensors are read, joined and kept."""
OAK = (
    option("number", "fps", "X", "Frames per second", 60.0, low=POSITIVE, high=120),
    option("choice", "sync", "", "How the cameras are synchronised", "none", choices=values("none", "wire", "ptp")),
    option("whole", "exposure", "MICROSECONDS", "Exposure time", 800),
    option("number", "flood", "SHARE", "Brightness of the infrared light", 1.0, low=0, high=1),
)
"""How infrared and depth are recorded."""
OAK_RECORDING = (
    place("folder", "folder", "FOLDER", "Folder to record to"),
    option("text", "oak", "ID[=NAME]", "A camera and its name; the first one sends the pulse", REQUIRED, repeated=True),
    option("number", "seconds", "S", "Length of the recording", 10.0, low=POSITIVE, high=3600),
)
"""Options of every verb that records OAK cameras."""

LINES = option("path", "lines", "LINES.jsonl", "Write the lines to this file, not to standard output", is_output=True)
SEND = option("text", "send", "vmc://HOST:PORT", "Also send every pose by the VMC protocol; vmc:// alone is this "
              "machine, port 39539")  # fmt: skip
REPEAT = flag("repeat", "Replay in a loop")
SECONDS = option("number", "seconds", "S", "Stop after this many seconds", low=POSITIVE)
WITH_POINTS = flag("with_points", "Each line also holds the points, for a display")

MOTION_IN_AND_OUT = (
    place("path", "motion", "MOTION.npz", "Motion file to read"),
    place("path", "out", "OUT.npz", "Motion file to write", is_output=True),
)
PRIOR = option("path", "prior", "WEIGHTS.npz", "Pose-NDF's weights, if not those that ship")


def report(of: str) -> Setting:
    """Return the option ``--report``.

    Args:
        of: what the page is about.
    """
    return option("path", "report", "PAGE.html", f"Also write a page about {of}", is_output=True)


def marker_endings(*others: str) -> tuple[str, ...]:
    """Return the endings of the files that markers are written to."""
    return (*(f".{ending}" for ending in MARKER_FORMATS), *others)
