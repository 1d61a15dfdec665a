"""Define the verbs of ``dev.py`` and their options."""

from __future__ import annotations

from solver_backend.exchange.setting import Setting
from solver_backend.exchange.verb import Program, Verb, by_name, flag, option, output, place, values

READING = (
    option("number", "fps", "X", "Frame rate, if the capture has none"),
    option("text", "joint_set", "SET", "Keypoint set, when the number of keypoints fits several"),
    option("text", "unit", "UNIT", "Length unit of the recording, such as m or mm, to override the file's"),
    option("text", "up_axis", "AXIS", "Axis that points up in the recording, if not z"),
    option("text", "subject_prefix", "PREFIX", "Label prefix of the person, if a file has several people"),
)
"""Options of ``demo`` for reading the capture."""
DEMO = (
    place(
        "path",
        "capture",
        "CAPTURE",
        "Capture file or folder, or a folder of videos. Default: the embedded take",
        None,
        excludes="take",
    ),
    flag("markers", "The embedded take of optical markers", excludes="take"),
    output("DIR", "New or empty folder for the results", None, kind="folder"),
    option("choice", "method", "", "Solver", "global", choices=values("global", "sliding", "frame")),
    option("choice", "backend", "", "Arrays", "numpy", choices=values("numpy", "torch")),
    *READING,
    flag("trim", "Cut all cameras to the shortest"),
)
LINT = (flag("fix", "Fix formatting and simple faults"),)


def _verb(name: str, text: str, settings: tuple[Setting, ...] = ()) -> Verb:
    return Verb(name, text, name, "", lambda: settings)


VERBS = by_name((
    _verb("demo", "solve a capture, or the embedded one, and bake it in Blender", DEMO),
    _verb("test", "every check and the main tests. --all runs every test, and further arguments go to pytest"),
    _verb("lint", "the checks alone", LINT),
    _verb("bench", "benchmarks against their committed baseline"),
    _verb("build", "the extension's zip"),
    _verb("setup", "the environment alone"),
    _verb("docs", "the generated pages and charts of docs, and the site in build/site"),
    _verb("detectors", "an environment for MediaPipe, which finds keypoints in videos (downloads 150 MB, once)"),
))  # fmt: skip


def program(head: str) -> Program:
    """Build the command line of ``dev.py`` from its docstring, with its first paragraph as summary."""
    return Program("dev.py", head.partition("\n")[0], VERBS, tuple, head.partition("\n\n")[2])
