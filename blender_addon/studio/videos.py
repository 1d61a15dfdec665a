"""One video a camera of a shot's colour pictures."""

from __future__ import annotations

import json
from pathlib import Path

from .._exchange.progress import Progress
from ..render.strips import encode_video
from .colour_film import FOLDER

VIDEOS = "videos"


def write_videos(out: Path, shots: list[str], progress: Progress) -> None:
    """Write ``videos/<camera>.mp4`` of every shot that has none; an odd last row or column is scaled away.

    Raises:
        RenderFailed: this Blender writes no video.
    """
    for done, name in enumerate(shots, start=1):
        folder = out / "shots" / name
        record = json.loads((folder / "shot.json").read_text(encoding="utf-8"))
        (folder / VIDEOS).mkdir(exist_ok=True)
        for camera, (width, height) in zip(record["cameras"], record["size"], strict=True):
            path = folder / VIDEOS / f"{camera}.mp4"
            if path.is_file():
                continue
            unfinished = path.with_name(f".unfinished-{path.name}")
            pictures = sorted((folder / FOLDER / camera).glob("*.png"))
            encode_video(pictures, (width // 2 * 2, height // 2 * 2), float(record["fps"]), unfinished)
            unfinished.rename(path)
        progress("videos", done, len(shots))
