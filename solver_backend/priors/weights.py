"""Read and write the weight files of priors: ``.npz`` without pickle, with checked metadata."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing, WeightsInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_JOINTS
from solver_backend.exchange.npz import read_npz
from solver_backend.exchange.outputs import atomic_output
from solver_backend.priors.autoencoder import DenseStack

FORMAT = "manifold_mocap_prior"
VERSION = 1
BODY_JOINTS: tuple[str, ...] = SMPL_JOINTS[1 : 1 + NUM_BODY_JOINTS]
ASSETS = Path(__file__).resolve().parents[1] / "assets"
"""Folder with the built-in weights."""


@dataclass(frozen=True)
class PriorWeights:
    """Arrays and metadata of a prior's weight file."""

    prior: str
    arrays: dict[str, np.ndarray]
    metadata: dict[str, Any]  # Architecture, training command, seed, metrics.
    sha256: str = ""

    def array(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """Return an array as float64 after checking its shape. None in ``shape`` allows any length.

        Raises:
            WeightsInvalid: the array is missing, not finite, or has another shape.
        """
        if name not in self.arrays:
            raise WeightsInvalid(f"The weights of {self.prior} do not contain the array {name!r}.")
        value = np.asarray(self.arrays[name])
        if value.dtype.kind not in "fiub":
            raise WeightsInvalid(f"The array {name!r} of {self.prior} is {value.dtype}, but numbers are expected.")
        value = value.astype(np.float64)
        fits = value.ndim == len(shape) and all(w in (None, h) for h, w in zip(value.shape, shape, strict=True))
        if not fits:
            raise WeightsInvalid(f"The array {name!r} of {self.prior} has the shape {value.shape}, not {shape}.")
        if not np.isfinite(value).all():
            raise WeightsInvalid(f"The array {name!r} of {self.prior} has values that are not numbers.")
        return value


def write_weights(path: Path, weights: PriorWeights) -> str:
    """Write a weight file atomically, and return the hash of its arrays."""
    digest = arrays_hash(weights.arrays)
    header = {"format": FORMAT, "version": VERSION, "prior": weights.prior, "body_joints": BODY_JOINTS}
    header |= {"sha256": digest, **weights.metadata}
    with atomic_output(path, overwrite=True) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, header=np.array(json.dumps(header)), **weights.arrays)
    return digest


def read_weights(path: Path, prior: str | None) -> PriorWeights:
    """Read and check the weight file of the given prior, or of any prior if None.

    Raises:
        FileMissing: the file does not exist.
        WeightsInvalid: it is not a weight file, is for another prior, body or version, or is damaged.
    """
    if not path.is_file():
        raise FileMissing(
            f"The weights of {prior or 'the prior'} are missing.",
            where=path.name,
            hint="Train them, or reinstall the program.",
        )
    try:
        arrays = read_npz(path)
        header = json.loads(str(arrays.pop("header")))
    except (FileDamaged, KeyError, ValueError, RecursionError) as error:
        raise WeightsInvalid("The file is not a weight file of a prior.", where=path.name, hint=str(error)) from error
    _check_header(header, prior, path.name)
    if arrays_hash(arrays) != header.get("sha256"):
        raise WeightsInvalid("The weights are damaged (another hash).", where=path.name, hint="Reinstall them.")
    return PriorWeights(header["prior"], arrays, header, header["sha256"])


def read_stack(
    weights: PriorWeights, part: str, inputs: int, outputs: int, *, activate_last: bool = False
) -> DenseStack:
    """Build a dense network from the arrays ``<part>_w0``, ``<part>_b0``, ... and the metadata of a weight file.

    Raises:
        WeightsInvalid: an array is missing or has another shape, or the activation is unknown.
    """
    hidden = weights.metadata.get(f"{part}_hidden", ())
    if not isinstance(hidden, list | tuple) or not all(type(n) is int and n > 0 for n in hidden):
        raise WeightsInvalid(
            f"The hidden widths of the {part} of {weights.prior} are {str(hidden)[:60]}, not whole numbers."
        )
    widths = (inputs, *hidden, outputs)
    matrices = tuple(weights.array(f"{part}_w{i}", (b, a)) for i, (a, b) in enumerate(pairwise(widths)))
    biases = tuple(weights.array(f"{part}_b{i}", (b,)) for i, b in enumerate(widths[1:]))
    return DenseStack(matrices, biases, str(weights.metadata.get("activation", "")), activate_last)


def arrays_hash(arrays: dict[str, np.ndarray]) -> str:
    """Return the SHA-256 hash of arrays with their names, types and shapes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        value = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {value.dtype.str} {value.shape}".encode())
        digest.update(value.tobytes())
    return digest.hexdigest()


def _check_header(header: Any, prior: str | None, where: str) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise WeightsInvalid("The file is not a weight file of a prior.", where=where)
    if header.get("version") != VERSION:
        raise WeightsInvalid(f"The weights have version {header.get('version')}, but {VERSION} is needed.", where=where)
    if not isinstance(header.get("prior"), str) or prior not in (None, header["prior"]):
        raise WeightsInvalid(f"The weights are for the prior {header.get('prior')!r}, not {prior!r}.", where=where)
    joints = header.get("body_joints")
    if not isinstance(joints, list) or tuple(joints) != BODY_JOINTS:
        hint = "They must be SMPL's joints 1 to 21."
        raise WeightsInvalid("The weights are for a body with other joints.", where=where, hint=hint)
