"""Markers out to TRC files, as OpenSim and others read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import NonFiniteData
from solver_backend.exchange.outputs import write_text
from solver_backend.io.recognition.length_unit import metres_in
from solver_backend.io.recognition.up_axis import rotation_to_z_up
from solver_backend.types import MarkerCloud


def write_trc(
    path: Path | str, cloud: MarkerCloud, *, unit: str = "mm", up_axis: str = "y", overwrite: bool = False
) -> Path:
    """Write markers to a TRC file, whole or not at all; missing ones are NaN.

    Args:
        path: the file.
        cloud: markers, Z up, in metres.
        unit: length unit of the file, a key of ``METRES``.
        up_axis: axis of the file that points up; OpenSim's is Y.
        overwrite: replace a file that is there.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        NonFiniteData: the frame rate is not positive.
        JobInvalid: the unit or the axis is unknown.
    """
    if not (np.isfinite(cloud.fps) and cloud.fps > 0):
        raise NonFiniteData(f"The frame rate must be a positive number, not {cloud.fps}.", where=str(path))
    positions = np.asarray(cloud.positions, dtype=np.float64)
    frames, markers = positions.shape[:2]
    labels = cloud.labels or tuple(f"*{i}" for i in range(1, markers + 1))
    values = (positions.reshape(-1, 3) @ rotation_to_z_up(up_axis) / metres_in(unit)).reshape(frames, 3 * markers)
    times = np.arange(frames) / cloud.fps
    # Single numbers as plain as they are: 100, not 100.000000, but 119.88012 in full.
    rate = f"{cloud.fps:.10g}"
    name = Path(path).name
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{markers}\t{unit}\t{rate}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(label.replace("\t", " ") for label in labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i}" for i in range(1, markers + 1) for axis in "XYZ"),
        "",
    ]
    rows = [
        f"{i}\t{time:.6f}\t" + "\t".join(f"{value:.6f}" if value == value else "NaN" for value in row)
        for i, (time, row) in enumerate(zip(times.tolist(), values.tolist(), strict=True), 1)
    ]
    return write_text(path, "\n".join(head + rows) + "\n", overwrite=overwrite)
