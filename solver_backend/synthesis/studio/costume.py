"""Create clothes and hair from patches of skin that are moved outwards.

The skin below a garment is removed except at the hem, so that it cannot pierce the garment in any pose. Garments taper
to the skin at their borders. Layers need no simulation and no mesh, because their vertices are offset body vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.types import SMPL_JOINTS

LABELS = ("nothing", "skin", "top", "bottom", "suit", "shoes", "hair", "marker", "furniture", "room")
SKIN, HAIR, MARKER, FURNITURE, ROOM = 1, 6, 7, 8, 9
_HEM_RINGS = 2  # Number of rings of skin below a garment's border that remain while the garment tapers.
_LEAST_M = 0.0006  # Smallest distance between layers in metres, so that none shows through another. Chosen by hand.
_WAVES = 10  # Number of waves that make up the folds. Chosen by hand.
_OUTFITS: dict[str, tuple[tuple[str, float], ...]] = {  # Layers from the skin outwards (m). Chosen by hand.
    "bare": (),
    "suit": (("suit", 0.002),),
    "shirt_trousers": (("shoes", 0.004), ("trousers", 0.008), ("shirt", 0.013)),
    "tee_shorts": (("shoes", 0.004), ("shorts", 0.012), ("tee", 0.012)),
    "tee_trousers": (("shoes", 0.004), ("trousers", 0.007), ("tee", 0.012)),
    "tunic_leggings": (("shoes", 0.003), ("trousers", 0.003), ("tunic", 0.016)),
}
_LABEL_OF = {"suit": "suit", "shoes": "shoes"}
_LABEL_OF |= dict.fromkeys(("trousers", "shorts"), "bottom") | dict.fromkeys(("shirt", "tee"), "top")
_LABEL_OF |= {"tunic": "top", "short": "hair", "long": "hair"}


@dataclass(frozen=True)
class Costume:
    """The surface of a dressed person: skin, clothes and hair, with N vertices and T triangles."""

    base: np.ndarray  # (N,) body vertex below each vertex.
    offset_m: np.ndarray  # (N,) offset in metres along the normal of the posed skin.
    faces: np.ndarray  # (T, 3) indices into the N vertices, counter-clockwise when seen from outside.
    label: np.ndarray  # (T,) uint8 index into ``LABELS``.
    part: np.ndarray  # (T,) joint that has the largest influence on each triangle.
    body_face: np.ndarray  # (T,) body triangle beneath each triangle.

    def posed(self, skin: np.ndarray, corners: CornerSums) -> np.ndarray:
        """Return the (F, N, 3) dressed surface over a posed skin (F, V, 3)."""
        if not self.offset_m.any():
            return skin[:, self.base]
        return skin[:, self.base] + self.offset_m[:, None] * corners.normals(skin)[:, self.base]


class CornerSums:
    """Computes vertex normals of a mesh with (T, 3) faces in any pose."""

    def __init__(self, faces: np.ndarray, count: int) -> None:
        flat = faces.ravel()
        self._faces = faces
        self._order = np.argsort(flat, kind="stable") // 3
        ends = np.cumsum(np.bincount(flat, minlength=count))
        self._used = np.flatnonzero(np.bincount(flat, minlength=count))
        self._starts = np.concatenate([[0], ends[:-1]])[self._used]

    def normals(self, vertices: np.ndarray) -> np.ndarray:
        """Return (F, V, 3) unit normals of (F, V, 3) vertices."""
        a, b, c = (vertices[:, self._faces[:, i]] for i in range(3))
        across = np.cross(b - a, c - a)
        total = np.zeros_like(vertices)
        total[:, self._used] = np.add.reduceat(across[:, self._order], self._starts, axis=1)
        return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-12)


def draw_outfit(clothes: str, hair: str, rng: np.random.Generator) -> tuple[str, str]:
    """Return the given clothes and hair. If a value is 'random', a random value replaces it."""
    dressed = [name for name in _OUTFITS if name not in ("bare", "suit")]
    drawn = str(rng.choice(dressed)), str(rng.choice(["none", "short", "short", "long"]))
    return (drawn[0] if clothes == "random" else clothes), (drawn[1] if hair == "random" else hair)


def dress(body: Body, clothes: str, hair: str, rng: np.random.Generator) -> Costume:
    """Dress a body with clothes and hair. ``rng`` determines folds and random hair."""
    layers = [*_OUTFITS[clothes], *(() if hair == "none" else ((hair, 0.012 if hair == "short" else 0.02),))]
    regions = _Regions(body)
    covers = [regions.of(name) for name, _ in layers]
    rings = [_rings_inside(body, cover) for cover in covers]
    parts = body.weights[body.faces].sum(axis=1).argmax(axis=1)
    base, offset = [np.arange(len(body.v_template))], [np.zeros(len(body.v_template))]
    kept = np.flatnonzero(~_hidden(body, rings))
    faces, label, body_face = [body.faces[kept]], [np.full(len(kept), SKIN)], [kept]
    start = len(body.v_template)
    for i, (name, thickness) in enumerate(layers):
        inside = covers[i][body.faces].all(axis=1)
        chosen = np.flatnonzero(inside & ~_hidden(body, rings[i + 1 :]))
        used, corner = np.unique(body.faces[chosen], return_inverse=True)
        taper = np.clip(rings[i][used] / _HEM_RINGS, 0.0, 1.0)
        folds = 1.0 + 0.35 * _folds(body.v_template[used], rng) * (thickness > 0.004)
        base.append(used)
        offset.append(_LEAST_M * (i + 1) * (taper > 0) + thickness * taper * np.maximum(folds, 0.25))
        faces.append(corner.reshape(-1, 3) + start)
        label.append(np.full(len(chosen), LABELS.index(_LABEL_OF[name])))
        body_face.append(chosen)
        start += len(used)
    base, offset, faces, label, over = map(np.concatenate, (base, offset, faces, label, body_face))
    return Costume(base, offset, faces, label.astype(np.uint8), parts[over], over)


def _hidden(body: Body, rings: list[np.ndarray]) -> np.ndarray:
    """Return a (T,) mask of the triangles that a garment covers completely, except the triangles at its hem."""
    hidden = np.zeros(len(body.faces), dtype=bool)
    for ring in rings:
        hidden |= (ring[body.faces] >= _HEM_RINGS).all(axis=1)
    return hidden


def _rings_inside(body: Body, cover: np.ndarray) -> np.ndarray:
    """Return the number of edges (V,) from each vertex to its region's border: at most 5, and 0 outside."""
    edges = np.concatenate([body.faces[:, [0, 1]], body.faces[:, [1, 2]], body.faces[:, [2, 0]]])
    inside = cover.copy()
    rings = np.zeros(len(cover))
    for _ in range(5):
        border = np.zeros(len(cover), dtype=bool)
        outer = ~inside[edges]
        border[edges[outer.any(axis=1)].ravel()] = True
        inside = inside & ~border
        rings += inside
    return rings


def _folds(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (N,) smooth fold heights between about -1 and 1. The waves run mostly across the body."""
    waves = rng.normal(size=(_WAVES, 3)) * [14.0, 26.0, 14.0]
    phases = rng.uniform(0, 2 * np.pi, _WAVES)
    return np.sqrt(2.0 / _WAVES) * np.cos(points @ waves.T + phases).sum(axis=1) * 0.7


class _Regions:
    """Skin regions of garments, defined by each vertex's main joint and position at rest."""

    def __init__(self, body: Body) -> None:
        owner = body.weights.argmax(axis=1)
        names = {joint: SMPL_JOINTS[k] for k, joint in enumerate(body.recorded_joints)}
        self._part = np.array([names.get(int(o), "hand").removeprefix("left_").removeprefix("right_") for o in owner])
        self._v = body.v_template
        joints = body.joints_template[list(body.recorded_joints)]
        self._at = {name: joints[k] for k, name in enumerate(SMPL_JOINTS)}

    def of(self, garment: str) -> np.ndarray:
        """Return the (V,) mask of the region that a garment covers."""
        return getattr(self, f"_{garment}")()

    def _in(self, *parts: str) -> np.ndarray:
        return np.isin(self._part, parts)

    def _y(self, name: str) -> float:
        return float(self._at[name][1])

    def _suit(self) -> np.ndarray:
        return ~self._in("head", "hand", "wrist", "neck") & ~self._shoes() & (self._v[:, 1] < self._y("neck") + 0.03)

    def _trunk(self) -> np.ndarray:
        below = self._v[:, 1] < self._y("neck") - 0.005
        return self._in("pelvis", "spine1", "spine2", "spine3", "collar", "neck") & below

    def _sleeves(self, reach: float) -> np.ndarray:
        return self._in("collar", "shoulder", "elbow", "wrist") & (np.abs(self._v[:, 0]) < reach)

    def _legs(self, lowest: float, waist: float) -> np.ndarray:
        y = self._v[:, 1]
        return self._in("pelvis", "hip", "knee", "ankle", "spine1") & (y > lowest) & (y < waist)

    def _shirt(self) -> np.ndarray:
        trunk = self._trunk() & (self._v[:, 1] > self._y("pelvis") - 0.04)
        return trunk | self._sleeves(abs(self._at["left_wrist"][0]) - 0.02)

    def _tee(self) -> np.ndarray:
        shoulder, elbow = abs(self._at["left_shoulder"][0]), abs(self._at["left_elbow"][0])
        trunk = self._trunk() & (self._v[:, 1] > self._y("pelvis") - 0.04)
        return trunk | self._sleeves(0.4 * shoulder + 0.6 * elbow)

    def _tunic(self) -> np.ndarray:
        thigh = 0.6 * self._y("left_hip") + 0.4 * self._y("left_knee")
        thighs = self._in("pelvis", "hip") & (self._v[:, 1] > thigh)
        return self._trunk() | self._sleeves(abs(self._at["left_elbow"][0]) + 0.08) | thighs

    def _trousers(self) -> np.ndarray:
        return self._legs(self._y("left_ankle") + 0.02, self._y("spine1") - 0.01)

    def _shorts(self) -> np.ndarray:
        return self._legs(self._y("left_knee") + 0.06, self._y("spine1") - 0.01)

    def _shoes(self) -> np.ndarray:
        return self._in("ankle", "foot", "knee") & (self._v[:, 1] < self._y("left_ankle") + 0.01)

    def _short(self) -> np.ndarray:
        head, v = self._at["head"], self._v
        behind = np.clip((head[2] + 0.055 - v[:, 2]) / 0.1, 0.0, 1.0)
        return self._in("head", "neck") & (v[:, 1] > head[1] + 0.125 - 0.115 * behind)

    def _long(self) -> np.ndarray:
        head, v = self._at["head"], self._v
        behind = np.clip((head[2] + 0.055 - v[:, 2]) / 0.09, 0.0, 1.0)
        return self._in("head", "neck", "spine3") & (v[:, 1] > head[1] + 0.12 - 0.24 * behind)
