"""Calibrations of programs that are recognised but not supported, and how to convert them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

_FORMATS = {
    ".xcp": ("Vicon's cameras", "Convert it by Pose2Sim's calibration (convert, vicon), which writes a .toml."),
    ".mat": ("a MATLAB file", "Write K, R and t of each camera as JSON, with MATLAB's jsonencode."),
    ".pkl": ("a Python pickle, which runs code when it is read", "Write its arrays with numpy.savez or as JSON."),
    ".pickle": ("a Python pickle, which runs code when it is read", "Write its arrays with numpy.savez or as JSON."),
    ".cal": ("a binary calibration", "Export it as text: OpenCV's YAML, or a projection matrix a camera."),
}
"""What files of each ending are, and the way out."""


def name_unsupported(folders: Iterable[Path]) -> tuple[str, str] | None:
    """Return a sentence on the first such file in the folders, and how to convert it; None where there is none."""
    for folder in folders:
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            if (known := _FORMATS.get(path.suffix.lower())) is not None:
                return f"{path.name} is {known[0]}, which is not read.", known[1]
    return None
