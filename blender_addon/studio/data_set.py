"""The colour pictures of a whole data set, shot by shot."""

from __future__ import annotations

from pathlib import Path

from .._exchange.errors import FileMissing
from .._exchange.progress import Progress
from .colour_film import film_in_colour

SHOTS = "shots"


def film_data_set_in_colour(out: Path, shots: list[str], frames: int, progress: Progress) -> int:
    """Render the colour pictures of every shot that has none yet, and return how many pictures were made.

    Args:
        out: folder of the data set.
        shots: names of its shots.
        frames: of all shots, for the progress.
        progress: called for every frame.

    Raises:
        FileMissing: a shot is not there.
        RenderFailed: Blender cannot render here.
    """
    made, each = 0, max(1, frames // max(len(shots), 1))
    for number, name in enumerate(shots):
        folder = out / SHOTS / name
        if not (folder / "shot.json").is_file():
            raise FileMissing("The shot is not there.", where=str(folder), hint="Run the studio again.")
        start = number * each
        made += film_in_colour(folder, lambda n, start=start: progress("colour", start + n, frames))
        progress("colour", (number + 1) * each, frames)
    return made
