"""Writes pictures as a video that plays anywhere."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from solver_backend.exchange.outputs import atomic_output
from solver_backend.videos.files.container import library


def write_video(path: Path | str, pictures: Iterable[np.ndarray], fps: float, *, overwrite: bool = False) -> int:
    """Write (H, W, 3) uint8 pictures as H.264 in MP4 and return their number; odd sizes lose a row or column.

    Raises:
        BackendMissing: PyAV is not installed.
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    av, count = library(), 0
    with atomic_output(path, overwrite=overwrite) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = None
        for rgb in pictures:
            height, width = (n - n % 2 for n in rgb.shape[:2])
            if stream is None:
                stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
                stream.options = {"crf": "23", "preset": "veryfast"}
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb[:height, :width]), format="rgb24")
            container.mux(stream.encode(frame))
            count += 1
        if stream is not None:
            container.mux(stream.encode())
    return count
