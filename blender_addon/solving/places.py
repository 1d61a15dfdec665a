"""Where a capture's files are, and where its takes go."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from pathlib import Path

_FORBIDDEN = re.compile(r'[<>:"/\\|?*\x00-\x1f]+')


@dataclass(frozen=True)
class TakeFiles:
    """The files of one take."""

    number: int
    motion: Path
    report: Path
    job: Path


def safe_name(name: str) -> str:
    """Return a name that every system takes for a folder; letters of any script stay."""
    cleaned = _FORBIDDEN.sub("_", name).strip(" .")
    return cleaned or "capture"


def capture_folder(base: Path, source: Path) -> Path:
    """Return the folder of a capture's files: its name, and a mark that tells captures of one name apart."""
    mark = zlib.crc32(str(source).encode("utf-8", "surrogatepass")) & 0xFFFF
    return base / f"{safe_name(source.stem if source.suffix == '.npz' else source.name)}_{mark:04x}"


def next_take(folder: Path) -> TakeFiles:
    """Return the files of the next take; numbers that any file bears are not used again."""
    found = [re.match(r"take_(\d+)", path.name) for path in folder.glob("take_*")]
    number = 1 + max((int(match[1]) for match in found if match), default=0)
    stem = f"take_{number:02d}"
    return TakeFiles(number, folder / f"{stem}.npz", folder / f"{stem}.html", folder / f"{stem}.job.json")


def capture_root(path: Path) -> Path:
    """Return the capture that a dropped file belongs to.

    A file manager drops files, not folders: a frame of detections stands for the folder that holds the cameras'
    folders, a calibration or a settings file for its own folder. Folders and capture files stand for themselves.
    """
    if path.is_dir() or path.suffix.lower() == ".npz":
        return path
    folder = path.parent
    if path.suffix.lower() != ".json" or not _holds_frames(folder):
        return folder
    root = folder.parent
    return root.parent if root.name.lower() == "pose" else root


def _holds_frames(folder: Path) -> bool:
    """Return whether a folder holds one camera's detections: numbered JSON files, beside folders alike."""
    numbered = sum(1 for path in folder.glob("*.json") if re.search(r"\d", path.stem))
    return numbered > 1 or folder.name.lower().endswith(("_json", "json"))
