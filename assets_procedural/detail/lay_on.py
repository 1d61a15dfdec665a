"""All details in their order, on the half body first, so that both sides stay mirror images bit for bit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.detail.eyes import put_in_eye
from assets_procedural.detail.mouth import close_lips
from assets_procedural.detail.nails import put_on_nails
from assets_procedural.detail.patches import HalfBody
from assets_procedural.detail.toes import part_toes
from assets_procedural.detail.wrist import round_ulna
from assets_procedural.mesh.features import NONE
from assets_procedural.mesh.meshing import SymmetricMesh, check_closed, mirror_half
from assets_procedural.mesh.remeshing import on_grid


@dataclass(frozen=True)
class DetailedBody:
    """A body to be looked at from near."""

    mesh: SymmetricMesh
    """Closed and symmetric."""
    feature: Array
    """(T,) what each face shows: a number of ``features``."""


def lay_on_details(mesh: SymmetricMesh, joints: Array) -> DetailedBody:
    """Return the fitted mesh with eyes, closed lips, round wrists, toes apart and nails; fingers stay spread.

    Args:
        mesh: the fitted surface, floor at y = 0.
        joints: (24, 3) metres, in the same frame.

    Raises:
        BodyInvalid: what is to be replaced is not where it is looked for, or the result is not closed.
    """
    faces = mesh.faces[: len(mesh.faces) // 2]
    half = HalfBody(mesh.vertices[: faces.max() + 1], faces, np.full(len(faces), NONE))
    half = close_lips(put_in_eye(half))
    vertices = part_toes(round_ulna(half.vertices, joints), half.faces, joints)
    half = put_on_nails(HalfBody(vertices, half.faces, half.feature), joints)
    whole = mirror_half(on_grid(half.vertices), half.faces)
    check_closed(whole.faces, len(whole.vertices))
    return DetailedBody(whole, np.concatenate([half.feature, half.feature]))
