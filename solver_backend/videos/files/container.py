"""Opens a video; the one place that knows of PyAV, which the extra ``capture`` brings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solver_backend.exchange.errors import BackendMissing
from solver_backend.videos.files.errors import VideoUnreadable

if TYPE_CHECKING:
    from av.container import InputContainer

AGAIN = "Copy the file from the camera again, or leave this camera out."


@contextmanager
def opened(path: Path) -> Iterator[InputContainer]:
    """Yield the open container of a video; what goes wrong inside is reported in our own words.

    Raises:
        BackendMissing: PyAV is not installed.
        VideoUnreadable: the file is missing, empty, broken or no video.
    """
    av = library()
    if not path.is_file():
        raise VideoUnreadable("There is no such video.", where=str(path), hint="Check the path.")
    if path.stat().st_size == 0:
        raise VideoUnreadable("The video is empty: its file has no bytes.", where=str(path), hint=AGAIN)
    try:
        with av.open(str(path)) as container:
            yield container
    except av.error.FFmpegError as error:
        raise VideoUnreadable(
            f"The video cannot be read: {error.strerror}.", where=str(path),
            hint=f"It may have been cut off while it was recorded or copied. {AGAIN}",
        ) from error  # fmt: skip


def video_stream(container: InputContainer) -> Any:
    """Return the first stream of pictures.

    Raises:
        VideoUnreadable: there is none.
    """
    if not container.streams.video:
        raise VideoUnreadable(
            "The file holds no pictures, perhaps sound alone.", where=str(container.name), hint="Choose the video."
        )
    return container.streams.video[0]


def library() -> Any:
    """Return PyAV.

    Raises:
        BackendMissing: it is not installed.
    """
    try:
        import av
        import av.error
        import av.logging
    except ModuleNotFoundError as error:
        raise BackendMissing(
            "Videos are read with PyAV, which is not installed.", hint="Install it with: pip install av."
        ) from error
    av.logging.set_level(None)
    return av
