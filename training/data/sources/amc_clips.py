"""Read Acclaim motions (AMC, optionally gzipped) with the solver's reader, and convert them to clips."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import require_file
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.motions.acclaim import read_pair
from solver_backend.io.motions.recorded_clip import HIP_SPLAY, RecordedClip

_TPOSE = {
    "lfemur": (0.0, 0.0, -HIP_SPLAY),
    "rfemur": (0.0, 0.0, HIP_SPLAY),
    "lowerneck": (-0.279, 0.0, 0.0),
    "upperneck": (0.367, 0.0, 0.0),
    "head": (0.192, 0.0, 0.0),
    "lhumerus": (0.0, 0.0, -0.14),
    "rhumerus": (0.0, 0.0, 0.14),
}
"""Rotation vectors of the T-pose in radians, as in other conversions of the same recordings."""


def read_amc(path: Path, skeleton: Path) -> RecordedClip:
    """Read an AMC motion together with its ASF skeleton.

    Raises:
        FileMissing: the file does not exist.
        FileDamaged, NonFiniteData: the file is not valid (see ``read_pair``), or a ``.gz`` file is not gzipped.
    """
    name = require_file(path).name.split(".")[0]
    with TemporaryDirectory() as folder:
        plain = Path(folder) / f"{name}.amc"
        try:
            plain.write_bytes(gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes())
        except (OSError, EOFError, zlib.error) as error:
            raise FileDamaged("The motion is damaged or not gzipped.", where=path.name, hint=str(error)) from error
        clip = read_pair(skeleton, plain)
    count = next((j for j, joint in enumerate(clip.names) if joint.endswith("_end")), len(clip.names))
    parents, G = np.array(clip.parents[:count]), clip.turns[:, :count]
    local = np.where((parents < 0)[:, None, None], G, np.swapaxes(G[:, parents], -1, -2) @ G)
    tpose = np.array([_TPOSE.get(joint, (0.0, 0.0, 0.0)) for joint in clip.names[:count]])
    return RecordedClip(name, list(clip.names[:count]), parents, np.asarray(log_so3(local)), tpose, clip.fps)
