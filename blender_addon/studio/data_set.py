"""The colour pictures of a whole data set, and one video per camera of them."""

from __future__ import annotations

from pathlib import Path

from .._exchange.errors import FileMissing
from .._exchange.json_file import read_json_file
from .._exchange.outputs import unfinished_names
from .._exchange.progress import Progress
from ..render.strips import encode_video
from .colour_film import FOLDER, film_in_colour

SHOTS, VIDEOS = "shots", "videos"


def film_data_set_in_colour(out: Path, shots: list[str], frames: int, progress: Progress) -> int:
    """Render the colour pictures of every shot without them, and return the number of new pictures.

    Raises:
        FileMissing: a shot is missing.
        RenderFailed: Blender cannot render here.
    """
    made, each = 0, max(1, frames // max(len(shots), 1))
    for number, name in enumerate(shots):
        folder = out / SHOTS / name
        if not (folder / "shot.json").is_file():
            raise FileMissing("The shot is missing.", where=str(folder), hint="Run the studio again.")
        start = number * each
        made += film_in_colour(folder, lambda n, start=start: progress("colour", start + n, frames))
        progress("colour", (number + 1) * each, frames)
    return made


def write_videos(out: Path, shots: list[str], progress: Progress) -> None:
    """Write ``videos/<camera>.mp4`` of every shot without it, scaled to even sizes.

    Raises ``RenderFailed`` if this Blender writes no video.
    """
    for done, name in enumerate(shots, start=1):
        folder = out / SHOTS / name
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
