"""Our subject file: a person's shape and places of markers, in one ``.npz``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.schema import read_fields
from solver_backend.io.native.provenance import read_provenance
from solver_backend.types import NUM_BETAS, MarkerSubject

FORMAT, VERSION = "manifold_mocap_subject", 1
_STORED = (
    "format", "version", "body", "betas", "marker_labels", "marker_places", "offsets", "marker_sigma", "skin_distance",
    "provenance",
)  # fmt: skip


def write_subject(path: Path | str, subject: MarkerSubject, *, overwrite: bool = False) -> Path:
    """Write a subject.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    arrays = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "body": np.array(subject.body),
        "betas": np.asarray(subject.betas, np.float64),
        "marker_labels": np.array(subject.labels, np.str_),
        "marker_places": np.array(subject.places, np.str_),
        "offsets": np.asarray(subject.offsets, np.float64),
        "marker_sigma": np.asarray(subject.sigma_m, np.float64),
        "skin_distance": np.asarray(subject.skin_m, np.float64),
        "provenance": np.array(json.dumps(subject.provenance, sort_keys=True)),
    }
    return write_npz(path, arrays, overwrite=overwrite)


def read_subject(path: Path | str) -> MarkerSubject:
    """Read a subject file.

    Raises:
        FileMissing, FileDamaged: it is not there, truncated, of another format or lacks fields.
        SubjectInvalid: its values are impossible.
    """
    fields = read_fields(path, _STORED)
    fields.require_format(FORMAT, VERSION)
    labels = fields.texts("marker_labels")
    return MarkerSubject(
        body=fields.text("body"),
        betas=fields.numbers("betas", (NUM_BETAS,)),
        labels=labels,
        places=fields.texts("marker_places"),
        offsets=fields.numbers("offsets", (len(labels), 3)),
        sigma_m=fields.numbers("marker_sigma", (len(labels),)),
        skin_m=fields.numbers("skin_distance", (len(labels),)),
        provenance=read_provenance(fields),
    )
