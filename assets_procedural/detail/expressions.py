"""Compute the face's 52 shapes under ARKit's names, from geometry and ``face.json``.

A lid slides over its eyeball, and an iris rotates with its eyeball under fixed lids. The lower lip rotates with the jaw
about an axis through the jaw's joints, weighted by a harmonic field. A stroke moves the skin around a point by a smooth
bump. When lips part, their seam is pulled back into the mouth. The skin inside the mouth has its own material.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from assets_procedural.arrays import FLIP, NUMBERS, Array, neighbour_graph, smooth_step
from assets_procedural.detail.eyes import EYEBALL_M, IRIS_M, PUPIL_M
from assets_procedural.mesh.charts import EYEBALL, IRIS, LIPS, PUPIL
from assets_procedural.skeleton.skinning import cotangent_laplacian
from solver_backend.live.face_source import BLEND_SHAPES

_TABLE = json.loads((NUMBERS / "face.json").read_text(encoding="utf-8"))
MOUTH = 7  # Material of the inside of the mouth. It follows the materials in ``charts``.
_MEETING = 0.12  # Height of the line between closed lids, as a fraction of the opening.
_OVER_M = 0.0005  # Extra distance between a closed lid and its eyeball, for the cornea.
_LID_SHARES = (0.0, 0.22, 0.48, 0.76)  # Rings of the lids from edge to rim, as in ``eyes``.
_RELAXED, _WIDE = 0.2, 0.22  # Fraction of a blink at rest, and by which wide eyes open further. Chosen by hand.
_GAZE = {"Up": (0.0, 11.0, -0.25), "Down": (0.0, -16.0, 0.35), "In": (-25.0, 0.0, 0.0), "Out": (25.0, 0.0, 0.0)}
"""Rotation of the left eye to the left and upwards at value 1, in degrees, and the fraction of a blink added to it."""
_UNDER_LID, _CORNEA_M = 0.86, 0.0006  # As in ``eyes``.
_JAW_DEG = 19.0  # Rotation of the jaw at value 1, about two thirds of the widest opening.
_JAW_JOINT, _JAW_ANGLE = np.array([0.0, 0.040, 0.014]), np.array([0.052, -0.012, 0.020])  # Relative to the head joint.
_AT_CORNER = 0.35  # Fraction of the jaw's rotation at the corners of the mouth.
_INWARDS = 0.85  # Backward movement of the seam when lips part, as a fraction of the gap.
_TONGUE = np.array([0.0, -0.003, 0.019]), 0.011  # Movement of the seam's centre and its half width, in metres.
_HEAD_M = 0.24  # Distance from the head joint within which facial shapes move the skin.


@dataclass(frozen=True)
class Expressions:
    """Arrays of the facial shapes that Blender adds to the body."""

    names: tuple[str, ...]
    offsets: Array  # (52, V, 3) metres at value 1, from the relaxed face.
    relaxed: Array  # (V, 3) metres from the face in the body file to the relaxed face.
    material: Array  # (F,) as in ``charts``, plus the inside of the mouth. Irises rotate with their rings.


def build_expressions(vertices: Array, faces: Array, material: Array, mirror: Array, head: Array) -> Expressions:
    """Build the facial shapes of a symmetric body at rest."""
    eye, mouth = _Eye(vertices, faces, material), _Mouth(vertices, faces, material, head)
    blink, jaw = eye.blink(), mouth.jaw_turn()
    upper = blink * (blink[:, 1] < 0)[:, None]
    strokes = _TABLE["strokes"].items()
    shapes = {name: mouth.stroked(parts, eye.front, both=name in BLEND_SHAPES) for name, parts in strokes}
    shapes |= {"eyeBlink": (1.0 - _RELAXED) * blink, "eyeWide": -_WIDE * upper, "jawOpen": jaw}
    shapes |= {f"eyeLook{way}": eye.gaze(x, y) + share * upper for way, (x, y, share) in _GAZE.items()}
    shapes |= {"jawForward": mouth.jaw[:, None] * [0.0, 0.0, 0.008], "jawLeft": mouth.jaw[:, None] * [0.009, 0.0, 0.0]}
    shapes["tongueOut"] = mouth.tongue()
    shapes["mouthClose"] = -jaw * mouth.closing[:, None]
    offsets = np.zeros((len(BLEND_SHAPES), *vertices.shape))
    for k, name in enumerate(BLEND_SHAPES):
        side = next((side for side in ("Left", "Right") if name.endswith(side)), "")
        base = name.removesuffix(side)
        found = shapes[base] if base in shapes else shapes[f"{base}Left"]
        offsets[k] = mouth.part_lips(found[mirror] * FLIP if side == "Right" else found)
    offsets[BLEND_SHAPES.index("tongueOut")] = mouth.tongue()
    white = np.isin(faces, np.concatenate([eye.white, mirror[eye.white]])).any(axis=1) & (material == IRIS)
    shown = np.select([white, mouth.inside], [EYEBALL, MOUTH], material)
    return Expressions(BLEND_SHAPES, offsets, _RELAXED * (blink + blink[mirror] * FLIP), shown)


class _Eye:
    """Vertex rings of the left eye: outwards over the lids, and inwards over the eyeball to the pupil."""

    def __init__(self, vertices: Array, faces: Array, material: Array) -> None:
        self._vertices, count = vertices, len(vertices)
        left = vertices[faces].mean(axis=1)[:, 0] > 0
        ball = faces[left & np.isin(material, (EYEBALL, IRIS, PUPIL))]
        of_ball, of_skin = np.isin(np.arange(count), ball), np.isin(np.arange(count), faces[material < LIPS])
        graph = neighbour_graph(faces, count)
        inner = _rings(graph, of_ball & of_skin, of_ball, 5)
        middle = vertices[inner[5][0]]
        depth = np.sqrt(EYEBALL_M**2 - np.sum((vertices[inner[0], :2] - middle[:2]) ** 2, axis=1))
        self._centre = np.array([*middle[:2], float(np.mean(vertices[inner[0], 2] - depth))])
        self._inner = self._matched([self._by_angle(ring) for ring in inner[:5]])
        self._lids = _rings(graph, of_ball & of_skin, ~of_ball | of_skin, len(_LID_SHARES))[1:]
        self.front, self.white = middle, np.concatenate(self._inner[:2])

    def blink(self) -> Array:
        """Return the offsets (V, 3) in metres that close the lids."""
        vertices, offsets, edge = self._vertices, np.zeros_like(self._vertices), self._by_angle(self._lids[0])
        x, y, _ = vertices[edge].T
        outer, inner = int(x.argmax()), int(x.argmin())
        chord = np.interp(x, x[[inner, outer]], y[[inner, outer]])
        above, below = (edge[np.sort(np.r_[np.flatnonzero(sign * (y - chord) >= 0), outer, inner])] for sign in (1, -1))
        for ring, share in zip(self._lids, _LID_SHARES, strict=True):
            at = vertices[ring]
            upper, lower = (_height(vertices[line], at[:, 0]) for line in (above, below))
            is_upper = at[:, 1] > np.interp(at[:, 0], x[[inner, outer]], y[[inner, outer]])
            meeting = lower + _MEETING * (upper - lower)
            moved = at.copy()
            moved[:, 1] += np.where(is_upper, meeting - upper, meeting - lower) * (1.0 - share) ** 1.2
            over = at[:, 2] - self._ball(at) + _OVER_M * (1.0 - share) * is_upper
            moved[:, 2] = self._ball(moved) + over
            offsets[ring] = moved - at
        return offsets

    def gaze(self, left_deg: float, up_deg: float) -> Array:
        """Return the offsets (V, 3) in metres that rotate the eye under fixed lids."""
        seen, _, iris, _, _ = self._inner
        vertices, offsets, centre = self._vertices, np.zeros_like(self._vertices), self._centre[:2]
        to = centre + EYEBALL_M * np.sin(np.deg2rad([left_deg, up_deg]))
        out = vertices[seen, :2] - to
        angle, reach = np.arctan2(out[:, 1], out[:, 0]), np.linalg.norm(out, axis=1)
        way = vertices[iris, :2] - centre
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        radius = np.interp(
            np.arctan2(way[:, 1], way[:, 0]), angle[np.argsort(angle)], reach[np.argsort(angle)], period=2 * np.pi
        )
        radius = np.minimum(IRIS_M, _UNDER_LID * radius)[:, None]
        new = {2: to + radius * way, 3: to + 0.64 * radius * way, 4: to + np.minimum(PUPIL_M, 0.6 * radius) * way}
        new[1] = 0.5 * (vertices[seen, :2] + new[2])
        for k, xy in new.items():
            squared = np.sum((xy - to) ** 2, axis=1) / (1.1 * IRIS_M) ** 2
            depth = self._ball(xy) + _CORNEA_M * np.maximum(1.0 - squared, 0.0)
            offsets[self._inner[k]] = np.column_stack([xy, depth]) - vertices[self._inner[k]]
        middle = int(np.linalg.norm(vertices - self.front, axis=1).argmin())
        offsets[middle] = [*to, self._ball(to[None])[0] + _CORNEA_M] - vertices[middle]
        return offsets

    def _matched(self, rings: list[Array]) -> list[Array]:
        """Shift the vertex order of each ring, so that equal indices are on a line from the lids to the pupil."""
        seen, half, iris, *inside = rings
        at, rolls = self._vertices[:, :2], [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        off = [np.linalg.norm(2 * at[np.roll(half, b)] - at[np.roll(seen, a)] - at[iris]) for a, b in rolls]
        a, b = rolls[int(np.argmin(off))]
        way = at[iris] - self._centre[:2]
        for k, ring in enumerate(inside):
            reach = np.linalg.norm(at[ring] - self._centre[:2], axis=1).mean() / np.linalg.norm(way, axis=1).mean()
            gap = [np.linalg.norm(at[np.roll(ring, c)] - self._centre[:2] - reach * way) for c in (-1, 0, 1)]
            inside[k] = np.roll(ring, int(np.argmin(gap)) - 1)
        return [np.roll(seen, a), np.roll(half, b), iris, *inside]

    def _by_angle(self, ring: Array) -> Array:
        away = self._vertices[ring, :2] - self._centre[:2]
        return ring[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]

    def _ball(self, points: Array) -> Array:
        squared = EYEBALL_M**2 - np.sum((points[:, :2] - self._centre[:2]) ** 2, axis=1)
        return self._centre[2] + np.sqrt(np.maximum(squared, (0.25 * EYEBALL_M) ** 2))


class _Mouth:
    """The lips, the jaw, and the landmarks that place strokes (smooth bumps that move the skin)."""

    def __init__(self, vertices: Array, faces: Array, material: Array, head: Array) -> None:
        self._vertices, self._faces, self._head = vertices, faces, head
        count, lips = len(vertices), np.unique(faces[material == LIPS])
        of_lips, graph = np.isin(np.arange(count), lips), neighbour_graph(faces, count)
        rim = of_lips & np.isin(np.arange(count), faces[material != LIPS])
        rings = _rings(graph, rim, of_lips, 4)
        self._seam, self._inner = rings[4], rings[3]
        x, y, _ = vertices[self._seam].T
        self._seam = self._seam[np.argsort(x)]
        self._corner = vertices[self._seam[-1]]
        self.inside = np.isin(faces, self._seam).any(axis=1)
        line = np.interp(vertices[:, 0], x[np.argsort(x)], y[np.argsort(x)])
        beyond = np.maximum(np.abs(vertices[:, 0]) - self._corner[0], 0.0)
        self._above = smooth_step((vertices[:, 1] - line) / (4e-4 + beyond), -1.0, 1.0)
        self._above[self._seam] = 0.5
        front = vertices[(np.abs(vertices[:, 0]) < 1e-6) & (vertices[:, 2] > head[2])]
        mouth = vertices[self._seam[len(self._seam) // 2]]
        below = front[(front[:, 1] < mouth[1] - 0.024) & (front[:, 1] > mouth[1] - 0.055)]
        self._places = {"mouth": mouth, "corner": self._corner, "chin": below[below[:, 2].argmax()]}
        self._places |= {"up": mouth + [0.0, 0.0045, 0.0], "low": mouth - [0.0, 0.0045, 0.0]}
        self._places["nostril"] = mouth + [0.014, 0.026, -0.004]
        self.jaw = self._jaw_share(lips)
        self.closing = smooth_step(vertices[:, 1], mouth[1] - 0.030, mouth[1] - 0.008)

    def jaw_turn(self) -> Array:
        axis = self._head + _JAW_JOINT
        turned = Rotation.from_rotvec([np.deg2rad(_JAW_DEG), 0.0, 0.0]).apply(self._vertices - axis) + axis
        return self.jaw[:, None] * (turned - self._vertices)

    def stroked(self, strokes: list[list], eye: Array, *, both: bool) -> Array:
        """Return the offsets (V, 3) in metres that the strokes of one facial shape produce.

        Args:
            strokes: lists of landmark, offset from the landmark, radius, movement and, optionally, the lip to move.
            eye: (3,) foremost point of the left eye in metres.
            both: whether to mirror strokes that are not on the midline.
        """
        offsets, places = np.zeros_like(self._vertices), self._places | {"eye": eye, "brow": eye + [0.002, 0.021, 0.0]}
        for landmark, place, radius, move, *lip in strokes:
            at = self._on_skin(places[landmark] + place)
            mirrored = both and abs(at[0]) > 1e-3
            for flip in (np.ones(3), FLIP)[: 1 + mirrored]:
                away = np.linalg.norm(self._vertices - at * flip, axis=1) / (1.6 * radius)
                share = np.square(np.maximum(1.0 - away**2, 0.0))
                if lip:
                    share *= self._above if lip[0] == "u" else 1.0 - self._above
                offsets += share[:, None] * move * flip
        return offsets

    def tongue(self) -> Array:
        """Return the offsets (V, 3) in metres that push the middle of the lip seam out like the tip of a tongue."""
        offsets = np.zeros_like(self._vertices)
        across = np.minimum(np.abs(self._vertices[self._seam, 0]) / _TONGUE[1], 1.0)
        offsets[self._seam] = np.sqrt(1.0 - across**2)[:, None] * _TONGUE[0]
        return offsets

    def part_lips(self, offsets: Array) -> Array:
        """Return offsets (V, 3) that keep the seam between the lips. Where lips part, the seam moves into the mouth."""
        found, vertices = offsets.copy(), self._vertices
        upper, lower = (self._inner[(self._above[self._inner] > 0.5) == above] for above in (True, False))
        x = vertices[self._seam, 0]
        lips = [
            np.stack([np.interp(x, *_sorted(vertices[lip, 0], offsets[lip, k])) for k in range(3)], 1)
            for lip in (upper, lower)
        ]
        gap = np.maximum(lips[0][:, 1] - lips[1][:, 1], 0.0) * (1.0 - (x / self._corner[0]) ** 2)
        found[self._seam] = 0.5 * (lips[0] + lips[1])
        found[self._seam, 2] -= _INWARDS * gap
        return found

    def _on_skin(self, place: Array) -> Array:
        near = self._vertices[
            (self._vertices[:, 2] > self._head[2] + 0.02) & (self._vertices[:, 1] > self._head[1] - 0.05)
        ]
        close = near[np.argsort(np.linalg.norm(near[:, :2] - place[:2], axis=1))[:4]]
        return np.array([*place[:2], close[:, 2].max()])

    def _jaw_share(self, lips: Array) -> Array:
        """Return the fraction (V,) of the jaw's rotation that each vertex follows."""
        vertices, head, corner = self._vertices, self._head, self._corner
        folded = vertices * np.where(vertices[:, :1] < 0, FLIP, 1.0)
        near = np.linalg.norm(vertices - head - [0.0, 0.05, 0.03], axis=1) < _HEAD_M
        chin, angle = self._places["chin"], head + _JAW_ANGLE
        bone = angle - chin
        t = ((folded - chin) @ bone / (bone @ bone)).clip(0.0, 1.0)
        along = np.linalg.norm(folded - chin - t[:, None] * bone, axis=1)
        moved = near & (along < 0.012)
        still = ~near | (vertices[:, 1] > corner[1] + 0.020)
        still |= (vertices[:, 1] < chin[1] - 0.045) | (vertices[:, 2] < head[2] - 0.005)
        opening = np.sqrt(np.maximum(1.0 - (folded[lips, 0] / corner[0]) ** 2, 0.0))  # an ellipse
        share, fixed = moved.astype(np.float64), moved | still
        above = self._above[lips]
        share[lips] = _AT_CORNER * (1.0 - opening) + (1.0 - above) * opening
        fixed[lips] = True
        laplacian, _ = cotangent_laplacian(vertices, self._faces)
        rows = sp.csr_matrix(laplacian[~fixed])
        share[~fixed] = spsolve(sp.csc_matrix(rows[:, ~fixed]), -(rows[:, fixed] @ share[fixed]))
        return share


def _rings(graph: sp.csr_matrix, start: Array, allowed: Array, count: int) -> list[Array]:
    """Return the allowed vertices at each edge distance (0 to ``count``) from the vertices ``start``."""
    reached, rings = start.copy(), [np.flatnonzero(start)]
    for _ in range(count):
        new = (graph @ np.isin(np.arange(len(start)), rings[-1]).astype(float) > 0) & allowed & ~reached
        reached |= new
        rings.append(np.flatnonzero(new))
    return rings


def _height(line: Array, x: Array) -> Array:
    return np.interp(x, *_sorted(line[:, 0], line[:, 1]))


def _sorted(x: Array, values: Array) -> tuple[Array, Array]:
    order = np.argsort(x, kind="stable")
    return x[order], values[order]
