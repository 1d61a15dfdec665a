"""One video a camera of a shot's colour pictures."""

from __future__ import annotations

from pathlib import Path

from .._exchange.json_file import read_json_file
from .._exchange.progress import Progress
from .._exchange.unfinished import unfinished_names
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
        record = read_json_file(folder / "shot.json")
        (folder / VIDEOS).mkdir(exist_ok=True)
        for camera, (width, height) in zip(record["cameras"], record["size"], strict=True):
            path = folder / VIDEOS / f"{camera}.mp4"
            if path.is_file():
                continue
            pictures = sorted((folder / FOLDER / camera).glob("*.png"))
            with unfinished_names(folder / VIDEOS) as name:
                unfinished = path.with_name(f"{name}{path.name}")
                encode_video(pictures, (width // 2 * 2, height // 2 * 2), float(record["fps"]), unfinished)
                unfinished.replace(path)
        progress("videos", done, len(shots))
