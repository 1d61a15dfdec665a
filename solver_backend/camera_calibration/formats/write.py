"""Write a calibration in any of the formats, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from solver_backend.camera_calibration.formats.colmap_files import colmap_texts
from solver_backend.camera_calibration.formats.opencv_yaml import opencv_yaml
from solver_backend.camera_calibration.formats.qualisys_file import qualisys_xml
from solver_backend.camera_calibration.formats.toml_files import caliscope_toml, pose2sim_toml
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.outputs import atomic_output, atomic_outputs
from solver_backend.types import Cameras

TOOL = "Manifold MoCap"
_TEXTS: dict[str, Callable[[Cameras, float | None], str]] = {
    "pose2sim": lambda cameras, rmse: pose2sim_toml(cameras, rmse, tool=TOOL),
    "anipose": lambda cameras, rmse: pose2sim_toml(cameras, rmse),
    "freemocap": lambda cameras, rmse: pose2sim_toml(cameras, rmse, scale=1000.0),
    "caliscope": caliscope_toml,
    "qualisys": qualisys_xml,
    "opencv": lambda cameras, rmse: opencv_yaml(cameras),
}
FORMATS = (*_TEXTS, "colmap")
"""Names of the formats; lengths are metres, but mm in FreeMoCap's and Qualisys'."""


def format_of(path: Path) -> str:
    """Return the format that a file's name stands for: TOML is Pose2Sim's, no suffix is a COLMAP folder.

    Raises:
        CommandLineInvalid: the name ends like none of them.
    """
    name = path.name.lower()
    if name.endswith((".qca.txt", ".qca")):
        return "qualisys"
    found = {".toml": "pose2sim", ".yml": "opencv", ".yaml": "opencv", "": "colmap"}.get(path.suffix.lower())
    if found is None:
        raise CommandLineInvalid(
            "A calibration is written as .toml, .yml, .qca.txt, or a folder (COLMAP).", where=str(path)
        )
    return found


def write_calibration(
    path: Path, cameras: Cameras, kind: str | None = None, rmse_px: float | None = None, *, overwrite: bool = False
) -> str:
    """Write cameras to a file, or a folder for COLMAP, and return the format's name.

    Args:
        path: file or folder.
        cameras: metres, Z up.
        kind: one of ``FORMATS``; taken from the name if left out.
        rmse_px: of the calibration, for people.
        overwrite: replace what is there.

    Raises:
        CommandLineInvalid: the format is unknown.
        CalibrationInvalid: the format cannot hold a lens.
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    kind = kind or format_of(path)
    if kind not in FORMATS:
        raise CommandLineInvalid(f"There is no calibration format '{kind}'.", hint=f"There are {', '.join(FORMATS)}.")
    if kind == "colmap":
        texts = colmap_texts(cameras)
        with atomic_outputs(path, tuple(texts), overwrite=overwrite) as places:
            for name, text in texts.items():
                places[name].write_text(text, encoding="utf-8")
        return kind
    text = _TEXTS[kind](cameras, rmse_px)
    with atomic_output(path, overwrite=overwrite) as place:
        place.write_text(text, encoding="utf-8")
    return kind
