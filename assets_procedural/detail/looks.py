"""Build the looks of the shown body: athletic wear with and without short hair, a mannequin and coloured segments.

A look defines a material per face and moves the skin. Vertices slide onto hems, hairlines and joints (``mesh.lines``).
Cloth spans the furrows of the body, a shoe covers the toes, and hair covers the scalp. Soles keep their height. Lengths
are in metres, heights are above the floor, and ``x`` is the distance from the midline.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from assets_procedural.arrays import FLIP, Array, averaging, neighbour_graph, smooth_step
from assets_procedural.mesh.charts import NAIL, SKIN, SUIT
from assets_procedural.mesh.lines import Field, LinedMesh
from assets_procedural.skeleton.shown import DeltaMush
from assets_procedural.skeleton.skinning import vertex_areas, vertex_normals

HAIR, SHIRT, TRIM, SHORTS, SOCK, SHOE, SOLE = range(8, 15)  # Materials that follow those of ``expressions``.
SEGMENTS = ("Head", "Neck", "Chest", "Abdomen", "Pelvis", "Arm", "Forearm", "Hand", "Thigh", "Shank", "Foot", "Toes")
FIRST_SIDED = SEGMENTS.index("Arm")  # From here on, segments have two sides. All right ones follow the left ones.
_HAIRLINE = (
    (-0.12, 1.512), (-0.06, 1.516), (-0.025, 1.532), (-0.010, 1.575), (-0.003, 1.618), (0.02, 1.632), (0.04, 1.628),
    (0.055, 1.612), (0.065, 1.615), (0.080, 1.638), (0.095, 1.648), (0.115, 1.656), (0.14, 1.660),
)  # fmt: skip
"""Height of the hairline by z, from the nape over the ear to the forehead, in metres. Chosen by eye."""
_BROW = (0.0135, 1.6125), (0.033, 1.6165), (0.0465, 1.6105)  # Centre line of a brow, as x and height.
_BROW_M = 0.0028  # Half the thickness of a brow.
_HEM_M, _GAP_M = 0.016, 0.003  # Width of a hem, and height of its step down to the skin.
_UNDER = -0.5  # Skin on a foot belongs to the sole if the upward part of its unit normal is below this.
_SHOE_M, _WRAP_M = 0.006, 0.012  # Distance of leather from the skin, and radius of the gaps that it covers.


@dataclass(frozen=True)
class Look:
    """Face materials and skin offsets of one look of the body in Blender, such as athletic wear."""

    material: Array  # (F,) material of each face.
    offsets: Array  # (V, 3) metres from the relaxed face.


class _Half:
    """The half body (x >= 0, floor at 0), and the data needed to mirror it."""

    def __init__(self, vertices: Array, faces: Array, mirror: Array) -> None:
        self.faces, self.floor, self._mirror = faces, vertices[:, 1].min(), mirror
        own = faces[: len(faces) // 2]
        self.mesh = LinedMesh(vertices[: own.max() + 1] - [0.0, self.floor, 0.0], own)

    def whole(self) -> Array:
        """Return the vertices (V, 3) of both halves, in metres."""
        half, found = self.mesh.vertices, np.zeros((len(self._mirror), 3))
        found[: len(half)], found[self._mirror[: len(half)]] = half, half * FLIP
        found[: len(half)] = half
        return found

    def marks(self, faces: Array) -> Array:
        """Return a mask (V,) of the vertices that belong to given faces of the half body or to their mirror images."""
        return np.isin(np.arange(len(self._mirror)), self.faces[np.concatenate([faces, faces])])


def build_looks(vertices: Array, faces: Array, mirror: Array, material: Array) -> dict[str, Look]:
    """Build all looks, by name, for a body at rest. ``material`` (F,) is the face material of ``build_expressions``."""
    body = vertices, faces, mirror
    wear = {"person": _athletic(*body, material), "shaven": _athletic(*body, material, hair=False)}
    return wear | {"mannequin": _jointed(*body), "segments": _segmented(*body)}


def _athletic(vertices: Array, faces: Array, mirror: Array, material: Array, *, hair: bool = True) -> Look:
    half = _Half(vertices, faces, mirror)
    mesh, own = half.mesh, material[: len(material) // 2].copy()
    own[own == SUIT] = SKIN
    scalp, brow = mesh.draw(_hairline), mesh.draw(_brow, _BROW_M, _BROW_M)
    collar = mesh.draw(_neckline, _HEM_M, _GAP_M)
    sleeve = mesh.draw(lambda p: p[:, 0] - 0.325, _HEM_M, _GAP_M)
    waist = mesh.draw(lambda p: 0.915 - p[:, 1], _HEM_M, _GAP_M)
    leg = mesh.draw(lambda p: 0.575 + 0.10 * (0.10 - p[:, 0]) - p[:, 1], _HEM_M, _GAP_M)
    sock = mesh.draw(lambda p: p[:, 1] - 0.150, _HEM_M, _GAP_M)
    shoe = mesh.draw(_shoe_collar, 0.009, _GAP_M)
    sole = mesh.draw(_sole, 0.0, _GAP_M)
    mesh.even_out(3)
    grown = scalp.inside & hair
    bare = (own == SKIN) | (own == NAIL) & shoe.inside  # eyes, lips and fingernails do not change
    shirt, shorts = collar.inside & sleeve.inside & waist.inside, leg.inside & ~waist.inside
    for chosen, number in (
        (brow.near | grown, HAIR),
        (shirt, SHIRT),
        ((collar.hem | sleeve.hem) & (shirt | collar.edge | sleeve.edge), TRIM),
        (shorts, SHORTS),
        (waist.edge, SHIRT),
        (leg.edge, SHORTS),
        (sock.inside | sock.edge, SOCK),
        (shoe.inside | shoe.edge, SHOE),
        (sole.inside, SOLE),
    ):
        own[chosen & bare] = number
    at = half.whole()
    dressed = _dress(half, at, half.marks(shirt), half.marks(shorts), half.marks(sock.inside & ~shoe.inside))
    dressed = _shod(half, dressed, half.marks(shoe.inside), half.marks(sole.inside))
    dressed = _grow_hair(half, dressed, half.marks(grown), half.marks(brow.near))
    return Look(np.concatenate([own, own]).astype(np.uint8), dressed + [0.0, half.floor, 0.0] - vertices)


def _hairline(p: Array) -> Array:
    z, height = np.array(_HAIRLINE).T
    return np.where(p[:, 1] > 1.47, np.interp(p[:, 2], z, height) - p[:, 1], 1.0)


def _brow(p: Array) -> Array:
    x, height = np.array(_BROW).T
    here = (p[:, 0] > x[0]) & (p[:, 0] < x[-1]) & (p[:, 2] > 0.07)
    return np.where(here, p[:, 1] - np.interp(p[:, 0], x, height), np.nan)


def _neckline(p: Array) -> Array:
    """Return how deep points are inside a sphere around the neck, in metres. Points above its centre get 1 (inside)."""
    centre, radius = np.array([0.0, 1.485, 0.012]), 0.088
    return np.where(p[:, 1] > centre[1], 1.0, radius - np.linalg.norm(p - centre, axis=1))


def _shoe_collar(p: Array) -> Array:
    """Return the height above the collar of a shoe, in metres."""
    return p[:, 1] - 0.078 - 4.0 * np.square(p[:, 2] + 0.022)


def _sole(p: Array) -> Array:
    """Return the height above a sole, which is thicker at the heel and the arch, in metres."""
    arch = np.exp(-np.square((p[:, 0] - 0.068) / 0.022) - np.square((p[:, 2] - 0.025) / 0.045))
    return p[:, 1] - 0.019 - 0.010 * smooth_step(-p[:, 2], -0.06, 0.05) - 0.014 * arch


def _dress(half: _Half, at: Array, shirt: Array, shorts: Array, sock: Array) -> Array:
    mush = DeltaMush(at, half.faces, 0.050)
    smooth = mush.smooth(mush.smooth(at))
    normals = vertex_normals(smooth, half.faces)
    bridged = np.maximum(np.einsum("va,va->v", smooth - at, normals), 0.0)
    x, h, z = np.abs(at[:, 0]), at[:, 1], at[:, 2]
    around = np.arctan2(z + 0.01, x)
    low = smooth_step(-h, -1.10, -0.93) * (x < 0.25)
    arm = smooth_step(x, 0.22, 0.33) * (h > 1.2)
    ease = 0.004 + 0.008 * low + 0.004 * arm + 0.005 * low * np.sin(7.0 * around + 1.0)
    ease += 0.0025 * arm * np.sin(5.0 * np.arctan2(z, h - 1.388) + 0.6)
    leg = smooth_step(-h, -0.86, -0.58)
    outer = smooth_step(x, 0.05, 0.11)
    fall = 0.003 + leg * (0.002 + 0.013 * outer) + 0.005 * leg * outer * np.sin(6.0 * np.arctan2(z, x - 0.1) + 0.5)
    amount = np.select([shirt, shorts, sock], [bridged + ease, bridged + fall, 0.0015 + 0.0 * h], 0.0)
    return at + amount[:, None] * normals


def _shod(half: _Half, at: Array, shoe: Array, sole: Array) -> Array:
    """Return the body's vertices (V, 3) in shoes. A shoe's surface is a level set around the skin of the foot."""
    mush, count = DeltaMush(at, half.faces, 0.020), len(half.mesh.vertices)
    foot, chosen = (at[:, 1] < 0.13) & (at[:, 0] > 0), np.flatnonzero(shoe & (at[:, 0] > 0))
    chosen = chosen[chosen < count]
    skin, area = at[foot], vertex_areas(at, half.faces)[foot] / (2.0 * np.pi * _WRAP_M**2)
    level = float(np.exp(-0.5 * (_SHOE_M / _WRAP_M) ** 2))

    def field(points: Array) -> Array:
        squared = np.square(points[:, None] - skin).sum(axis=2)
        return np.exp(-0.5 * squared / _WRAP_M**2) @ area

    smooth = mush.smooth(at)
    start, way = smooth[chosen], vertex_normals(smooth, half.faces)[chosen]
    wrapped, mean = at.copy(), averaging(neighbour_graph(half.faces, len(at)))
    height, lined = at[chosen, 1], sole[chosen] | half.mesh.fixed[chosen] & (at[chosen, 1] < 0.035)
    under = (at[chosen, 1] < 0.04) & (way[:, 1] < _UNDER)  # includes the arch
    for reach in (0.032,) + 8 * (0.008,):
        far, step = np.full(len(chosen), -0.004), 0.002
        for ahead in np.arange(-0.002, reach, step):
            far = np.where(field(start + ahead * way) >= level, ahead, far)
        for _ in range(6):
            step *= 0.5
            far = np.where(field(start + (far + step)[:, None] * way) >= level, far + step, far)
        wrapped[chosen] = start + far[:, None] * way
        wrapped[chosen, 1] = np.select([under, lined], [0.0, height], np.maximum(wrapped[chosen, 1], 0.0))
        start = 0.5 * wrapped[chosen] + 0.5 * (mean @ wrapped)[chosen]
    wall = chosen[lined & ~under]
    for _ in range(4):
        wrapped[np.ix_(wall, [0, 2])] = (mean @ wrapped)[np.ix_(wall, [0, 2])]
    out = way[:, [0, 2]] / np.maximum(np.linalg.norm(way[:, [0, 2]], axis=1, keepdims=True), 0.3)
    flange = sole[chosen] & ~under
    wrapped[np.ix_(chosen[flange], [0, 2])] += 0.005 * out[flange]
    half.mesh.vertices[:] = wrapped[:count]
    return half.whole()


def _grow_hair(half: _Half, at: Array, hair: Array, brow: Array) -> Array:
    normals = vertex_normals(at, half.faces)
    above = np.where(hair, -_hairline(at), 0.0)
    thick = 0.003 + 0.011 * smooth_step(above, 0.0, 0.06)
    return at + (hair * thick + 0.0012 * brow)[:, None] * normals


_PLANES = {
    "neck": ((0.0, 1.0, 0.55), (0.0, 1.440, 0.0)),
    "head": ((0.0, 1.0, 0.45), (0.0, 1.505, 0.0)),
    "chest": ((0.0, -1.0, 0.0), (0.0, 1.190, 0.0)),
    "waist": ((0.0, -1.0, 0.0), (0.0, 1.040, 0.0)),
    "hip": ((0.85, -1.0, 0.0), (0.0, 0.835, 0.0)),
    "knee": ((0.0, -1.0, 0.0), (0.0, 0.470, 0.0)),
    "ankle": ((0.0, -1.0, 0.0), (0.0, 0.092, 0.0)),
    "toes": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.108)),
    "shoulder": ((1.0, 0.15, 0.0), (0.205, 1.388, 0.0)),
    "elbow": ((1.0, 0.0, 0.0), (0.449, 0.0, 0.0)),
    "wrist": ((1.0, 0.0, 0.0), (0.685, 0.0, 0.0)),
}
"""Borders of the segments: normals that point away from the trunk, and points on the borders in metres."""
_BELOW = {"hip": 1.1, "toes": 0.12}  # Heights above which a plane does not cut.
_BEYOND = "Neck", "Head", "Abdomen", "Pelvis", "Thigh", "Shank", "Foot", "Toes", "Arm", "Forearm", "Hand"
"""Segment beyond each border. The chest is on the near side of all of them."""
_BANDS_M = {"neck": 0.0, "head": 0.0, "waist": 0.020, "chest": 0.020, "wrist": 0.012, "ankle": 0.014, "toes": 0.010}
"""Half the width of each of these joint bands on the mannequin, in metres. Chosen by eye."""
_BAND_M, _GROOVE_M = 0.028, 0.0025  # Half the width of all other joint bands on the mannequin, and the depth of all.


def _planes() -> Iterator[tuple[str, str, Field]]:
    """Yield each border's name, the segment beyond it, and a function for the signed distance to its plane."""
    for (name, (normal, point)), beyond in zip(_PLANES.items(), _BEYOND, strict=True):
        way, below = np.array(normal) / np.linalg.norm(normal), _BELOW.get(name, np.inf)

        def field(p: Array, way: Array = way, point: Array = np.array(point), below: float = below) -> Array:
            return np.where(p[:, 1] < below, (p - point) @ way, np.nan)

        yield name, beyond, field


def _segmented(vertices: Array, faces: Array, mirror: Array) -> Look:
    half = _Half(vertices, faces, mirror)
    left = np.full(len(half.mesh.faces), SEGMENTS.index("Chest"))
    for _, beyond, field in _planes():
        left[~half.mesh.draw(field).inside] = SEGMENTS.index(beyond)
    right = left + (left >= FIRST_SIDED) * (len(SEGMENTS) - FIRST_SIDED)
    return Look(np.concatenate([left, right]).astype(np.uint8), half.whole() + [0.0, half.floor, 0.0] - vertices)


def _jointed(vertices: Array, faces: Array, mirror: Array) -> Look:
    """Return the mannequin, which has a dark neck and dark grooves at the joints."""
    half = _Half(vertices, faces, mirror)
    dark = np.zeros(len(half.mesh.faces), bool)
    for name, _, field in _planes():
        width = _BANDS_M.get(name, _BAND_M)
        far = half.mesh.draw(lambda p, field=field, width=width: field(p) - width)
        near = half.mesh.draw(lambda p, field=field, width=width: field(p) + width) if width else far
        dark = (
            ~far.inside if name == "neck" else dark & far.inside if name == "head" else dark | far.inside & ~near.inside
        )
    at = half.whole()
    sunk = half.marks(dark) & ~half.marks(~dark) & (at[:, 1] > 0.01)
    moved = at - _GROOVE_M * sunk[:, None] * vertex_normals(at, faces) + [0.0, half.floor, 0.0] - vertices
    return Look(np.concatenate([dark, dark]).astype(np.uint8), moved)
