"""List the marker file formats. ``io/markers/read.py`` has a writer for each."""

from __future__ import annotations

from pathlib import Path

from .errors import FileDamaged
from .outputs import open_regular
from .plain_text import either

MARKER_FORMATS = {
    "c3d": ("C3D", "Labels and positions in millimetres, Z up, for optical systems and biomechanics"),
    "trc": ("TRC", "Labels and positions as text in millimetres, Y up, for OpenSim"),
}
"""Name and tooltip of each format, by file suffix."""


FORMAT_NAMES = either(name for name, _ in MARKER_FORMATS.values())  # Names of all formats, for use in sentences.


def file_names(stem: str, *others: str) -> str:
    """Return the file names of all marker formats for help texts, such as ``TAKE.c3d|TAKE.trc``."""
    return "|".join([*(f"{stem}.{ending}" for ending in MARKER_FORMATS), *others])


_MOTIONS = "live stream, motion denoise and hands add, and blender bake, export and retarget read motions."
_KINDS = {
    "manifold_mocap_capture": ("a capture", "solve, info and cameras check read captures."),
    "manifold_mocap_motion": ("a Manifold MoCap motion", _MOTIONS),
    "manifold_mocap_subject": ("a calibrated person", "solve, label and live read it as --subject."),
    "manifold_mocap_skeleton": ("a clip of another skeleton", "motion convert converts it."),
    "manifold_mocap_actor": (
        "the motion of an actor",
        "blender retarget passes it between its processes.",
    ),
    "manifold_mocap_detections": ("the detections of one video", "from-videos makes a capture of them."),
    "manifold_mocap_prior": (
        "the weights of a pose prior",
        "motion denoise and motion complete read those of Pose-NDF as --prior.",
    ),
    "manifold_mocap_studio_scene": ("the scene of a studio's shot", "blender dataset make renders it."),
}
"""Description of each file format, and the verbs that read it."""


def other_kind(found: str, expected: str, where: str) -> FileDamaged:
    """Return the error for a file that states the format ``found`` ("" if none) instead of ``expected``."""
    wanted = _KINDS[expected][0]
    if found in _KINDS:
        what, readers = _KINDS[found]
        hint = readers[0].upper() + readers[1:]
        return FileDamaged(f"The file is {what}, but {wanted} is expected.", where=where, hint=hint)
    stated = f"its format is '{found}'" if found else "it does not state a format"
    hint = "" if found else "`motion convert` reads AMASS files and network results."
    return FileDamaged(f"The file is not {wanted}: {stated}.", where=where, hint=hint)


REPORT_MARK = '<meta name="generator" content="Manifold MoCap report">'  # Text in the head of every report.
_HEAD_BYTES = 2000  # Number of bytes of a page that are searched for the mark. Chosen by hand.


def is_report(path: Path, folder: Path) -> bool:
    """Return whether a file directly inside a folder is a solve's report page."""
    try:
        inside = path.resolve().parent == folder.resolve()
        if path.suffix.lower() != ".html" or not inside or not path.is_file():
            return False
        with open_regular(path) as stream:
            return REPORT_MARK.encode() in stream.read(_HEAD_BYTES)
    except OSError:
        return False
