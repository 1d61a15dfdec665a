"""Find skin that touches the floor or objects, and keep it outside surfaces and in place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.biomechanics.support import FLOOR_M, SIGMA_M, SIGMA_M_S
from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.contact_parts import CONTACT_PARTS, FEET, part_of_joint
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.stands import SHORTEST_S, standing_runs, steps
from solver_backend.fitters.keyframes.frame_range import UserContact
from solver_backend.fitters.model.subject import PosedFrames, SkinTerms, Subject, points_of
from solver_backend.fitters.other_skin import OtherSkin, spread_vertices
from solver_backend.geometry.arrays import Array, constant, index, to_numpy, true_runs, zeros
from solver_backend.geometry.obstacles import Obstacles
from solver_backend.residuals.positions import BindingTerm, PositionTerm, SurfaceTerm

FLOOR = Obstacles.floor()
NEAR_M = 0.25  # A lower landmark may belong to a part that touches the floor, at the distance of flesh or half a hand.
DEEP_M = 0.01  # Skin that is deeper below the floor is evidence of a contact.
SAMPLE_S = 0.05  # Seconds between frames in which the whole skin is posed.
REACH_M = 0.03  # Skin up to this height above the floor may touch it after the solve.
SOLE_M = 0.02  # Foot vertices up to this height above the foot's lowest one at rest form its sole.
LEVEL_M = 0.03
"""Smallest depth in metres of the lowest skin that shows another floor level: between the mean of the deepest level
with a true floor, 8 mm (``bench contacts``, level_deepest), and a step or wrong floor of 5 cm."""
HANDS = (6, 7)  # Numbers of the hands' parts. Body keypoints do not determine the orientation of hands.
LOWEST_M = 0.01  # In a contact that the user added, skin up to this height above a part's lowest skin touches.
SURE = 3.09  # Normal quantile at which one in 1000 true surfaces is rejected.
SPACING_M = 0.03  # Distance between selected points on the skin.
DEPTH_SIGMA_M, HOLD_SIGMA_M = 0.002, 0.004
"""Standard deviations in metres of skin below the floor, and of held skin from its position. With 4 and 8 mm, skin in
the tuning clips (``bench contacts``, fit_floor) is 2 mm deeper and joints are equally accurate."""


@dataclass(frozen=True)
class SkinContacts:
    """Contacts of S skin points near the floor, objects or other people."""

    landmarks: Landmarks  # The person's L landmarks, followed by the S points.
    parts: np.ndarray  # (S,) number of each point's part in ``CONTACT_PARTS``.
    solid: np.ndarray  # (F, S) bool: the point must be outside the nearest surface.
    held: np.ndarray  # (F, S) bool: the point is fixed.
    added: np.ndarray  # (F, S) bool: held because of a contact that the user added.
    anchors: np.ndarray  # (F, S, 3) metres: position at which it is held.
    normals: np.ndarray  # (F, S, 3) unit normal of the nearest surface.
    offsets: np.ndarray  # (F, S) metres: ``n·x`` of that surface.
    afloat: np.ndarray  # (F,) bool: added contacts are fixed, because no floor or object is near.
    lowest: np.ndarray  # (F,) height of the lowest skin in metres. Hands below the floor are ignored.
    works: np.ndarray  # (F, 11) bool: parts with fixed skin, or that a surface moves by more than ``DEEP_M``.
    lost_floor: bool  # The person is on another floor than z = 0 in all frames.

    overlap_m: float = 0.0  # Largest depth in other people, metres.

    @property
    def binds(self) -> bool:
        """True if any point is fixed or must stay outside a surface."""
        return bool(self.solid.any() or self.held.any())

    def terms(self, like: Array, firmness: float) -> SkinTerms:
        """Return the terms that keep ``solid`` points outside surfaces, and ``held`` points at their anchors."""
        precision = np.where(self.solid, DEPTH_SIGMA_M**-2, 0.0)
        surface = SurfaceTerm(*(constant(part, like) for part in (self.normals, self.offsets, precision)))
        found, stated = (
            np.where(points, (firmness / HOLD_SIGMA_M) ** 2, 0.0)
            for points in (self.held & ~self.added, self.held & self.added)
        )
        anchors = constant(self.anchors, like)
        held = PositionTerm(anchors, constant(found, like)), BindingTerm(anchors, constant(stated, like))
        return SkinTerms(self.landmarks, (surface, *held))

    def notes(self) -> Iterator[Diagnostic]:
        """Yield diagnostics about fixed parts other than feet, overlaps with other people, and a wrong floor height."""
        found, afloat = self.touches[:, FEET:], self.afloat
        if found.any():
            names = list(CONTACT_PARTS)[FEET:]
            parts = [names[k].replace("_", " ") for k in np.flatnonzero(found.any(axis=0))]
            yield diagnostic("skin_held", parts=parts, count=int(found.any(axis=1).sum()))
        if self.overlap_m > DEEP_M:
            yield diagnostic("people_overlap", size=100 * self.overlap_m)
        level = float(np.median(self.lowest))
        if abs(level) > LEVEL_M and (self.lost_floor or afloat.any()):
            yield diagnostic("feet_off_floor", size=100 * abs(level), way="below" if level < 0 else "above")
        elif afloat.any():
            yield diagnostic("foot_below_floor", size=-100 * float(self.lowest[afloat].min()))

    def beside(self, other: SkinContacts) -> SkinContacts:
        """Append the skin points of other contacts, and use their overlap. Keep the height of the lowest skin."""
        points = ("solid", "held", "added", "anchors", "normals", "offsets")
        joined = {name: np.concatenate([getattr(self, name), getattr(other, name)], axis=1) for name in points}
        count = len(self.landmarks) - len(self.parts)
        landmarks = Landmarks.joined([self.landmarks, other.landmarks.part(slice(count, None))])
        parts, works = np.concatenate([self.parts, other.parts]), self.works | other.works
        return replace(self, landmarks=landmarks, parts=parts, works=works, overlap_m=other.overlap_m, **joined)

    @property
    def touches(self) -> np.ndarray:
        """Mask (F, 11) of the body parts whose skin is held in place by a contact."""
        return _by_part(self.held, self.parts)


def contradicts(works: np.ndarray, rise: np.ndarray) -> bool:
    """Return whether contacts worsen the fit by more than chance, so that a surface contradicts the measurements.

    Errors of calibration and keypoints are nearly constant over a take, so all frames of a part's contact count as one
    observation. The mean rise then has a chi-squared distribution, and the depth of each affected part is one degree of
    freedom. The quantile is from Wilson and Hilferty 1931, "The distribution of chi-square".

    Args:
        works: (F, 11) bool, parts that surfaces affect in each frame.
        rise: (F,) change in twice the measurements' robust cost due to the contacts.
    """
    works = works[:, works.any(axis=0)]
    share = works / works.sum(axis=0)
    spread = 2.0 / (9.0 * (works.sum(axis=1) @ share))
    limit = 2.0 / (9.0 * spread) * (1.0 - spread + SURE * np.sqrt(spread)) ** 3
    return bool((rise @ share > limit).any())


def _by_part(points: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return an (F, 11) mask of the parts that have at least one of the masked points (F, S)."""
    return np.stack([points[:, parts == k].any(axis=1) for k in range(len(CONTACT_PARTS))], axis=1)


def parts_of_skin(body: Body) -> np.ndarray:
    """Return each vertex's part in ``CONTACT_PARTS``, from its largest skinning weight."""
    numbers, of_joint = list(CONTACT_PARTS), np.full(len(body.parents), -1)
    for joint, (name, parent) in enumerate(zip(body.layout.joints, body.parents, strict=True)):
        part = part_of_joint(name)
        of_joint[joint] = of_joint[parent] if part is None else numbers.index(part)
    return of_joint[body.weights.argmax(axis=1)]


def find_skin_contacts(
    subject: Subject,
    frames: PosedFrames,
    points: np.ndarray,
    fps: float,
    world: Obstacles = FLOOR,
    told: Sequence[UserContact] = (),
    fixed: np.ndarray | None = None,
    *,
    detects: bool = True,
) -> SkinContacts | None:
    """Find skin contacts with the floor and objects.

    Return None if nothing touches, or if only feet touch and there are no objects. If the user changed contacts, there
    is always a result.

    A point touches with probability ``exp(-(max(z, 0) / σ)² / 2 - (v / τ)² / 2)``, given distance z and speed v. The
    point is fixed while the probability exceeds one half for at least the duration of a step. Points stay outside
    surfaces in all frames. The floor z = 0 is ignored in the frames that ``_off_floor`` finds.

    Args:
        frames: F solved poses.
        points: (F, L, 3) landmarks in these poses in metres.
        world: the floor, with or without objects.
        told: contacts that the user added or removed, which take precedence.
        fixed: (F,) bool, frames that do not move.
        detects: False to use only contacts that the user added.
    """
    body, low = subject.body, np.array([not _of_foot(name) for name in subject.landmarks.names])
    near = (points[:, low, 2] < NEAR_M).any(axis=1)
    if world.has_objects:
        near |= (world.without_floor.nearest(points, NEAR_M)[0] < NEAR_M).any(axis=1)
    near &= detects
    if not near.any() and not told:
        return None
    vertices = _low_vertices(subject, frames, np.flatnonzero(near), fps, world, told)
    parts = parts_of_skin(body)[vertices]
    others = (parts >= FEET) | world.has_objects
    if not (others.any() or (told and len(vertices))):
        return None
    skin, placed = _posed_skin(subject, frames, vertices)
    way, seconds = steps(placed, fps)
    speed, hands = np.linalg.norm(way, axis=-1) / seconds, np.isin(parts, HANDS)
    # Hands carry a person, but a hand below the floor does not show that the floor is wrong.
    lowest = np.where(hands, np.maximum(placed[..., 2], 0.0), placed[..., 2]).min(axis=1)
    off = _off_floor(lowest, fps, world)
    height, normals = world.nearest(placed, NEAR_M)
    if off.any():
        height[off], normals[off] = world.without_floor.nearest(placed[off], NEAR_M)
    is_known = np.isfinite(height)
    chance = np.exp(-0.5 * (np.maximum(height, 0.0) / SIGMA_M) ** 2 - 0.5 * (speed / SIGMA_M_S) ** 2)
    held = np.zeros(chance.shape, bool)
    for k in range(len(skin) if detects else 0):
        for first, stop in standing_runs(chance[:, k] > 0.5, fps):
            held[first:stop, k] = True
    touched = near & (held[:, others].any(axis=1) | (height[:, others] < -DEEP_M).any(axis=1))
    lost = bool(off.all()) and (world.has_objects or np.median(lowest) < 0.0)
    if not (touched.any() or told or lost):
        return None
    held &= touched[:, None]
    added = _obey(held, np.where(is_known.all(axis=1, keepdims=True), height, placed[..., 2]), parts, told)
    fixed = np.zeros(len(height), bool) if fixed is None else fixed
    joined = Landmarks.joined([subject.landmarks, skin])
    anchors = _anchors(placed - _shifts(height, held, parts)[..., None] * normals, held, fixed)
    offsets, afloat = (normals * placed).sum(axis=-1) - np.where(is_known, height, 0.0), (added & ~is_known).any(axis=1)
    solid = is_known & detects
    works = _by_part(held | (solid & (height < -DEEP_M)), parts)
    arrays = solid, held, added, anchors, normals, offsets, afloat, lowest, works
    return SkinContacts(joined, parts, *arrays, lost)


def find_touching_people(
    subject: Subject, frames: PosedFrames, fps: float, others: OtherSkin, seen: np.ndarray
) -> SkinContacts | None:
    """Find skin points near or inside other people. Return None if no skin point is deeper inside than ``DEEP_M``.

    The skin is not fixed to other people, because they move. Frames outside the (F,) mask ``seen`` have no contacts.
    """
    vertices, count = spread_vertices(subject.body), frames.transl.shape[0]
    sampled, known = np.arange(0, count, max(1, round(SAMPLE_S * fps))), np.flatnonzero(seen)
    skin, placed = _posed_skin(subject, frames.select(index(sampled, frames.transl)), vertices)
    near = (others.nearest(placed, sampled)[0] < REACH_M).any(axis=0)
    if not near.any():
        return None
    skin, placed = _posed_skin(subject, frames, vertices[near])
    height, normals = np.full(placed.shape[:2], np.inf), np.tile([0.0, 0.0, 1.0], (*placed.shape[:2], 1))
    height[known], normals[known] = others.nearest(placed[known], known)
    solid, parts = np.isfinite(height), parts_of_skin(subject.body)[vertices[near]]
    if not (height < -DEEP_M).any():
        return None
    still, none = np.zeros(solid.shape, bool), np.zeros(count)
    works, deepest = _by_part(height < -DEEP_M, parts), -float(height.min())
    # Each person moves out of the other by half the depth.
    height = np.where(solid, np.where(height < 0.0, 0.5 * height, height), 0.0)
    offsets = (normals * placed).sum(axis=-1) - height
    joined = Landmarks.joined([subject.landmarks, skin])
    arrays = solid, still, still, np.zeros(placed.shape), normals, offsets, none > 0.0, none, works
    return SkinContacts(joined, parts, *arrays, lost_floor=False, overlap_m=deepest)


def _posed_skin(subject: Subject, frames: PosedFrames, vertices: np.ndarray) -> tuple[Landmarks, np.ndarray]:
    body, names = subject.body, tuple(f"skin {vertex}" for vertex in vertices)
    arrays = (values[vertices] for values in (body.v_template, body.shapedirs, body.weights))
    skin = Landmarks.of_points(names, *arrays, posedirs=body.posedirs[vertices])
    bare = replace(subject, landmarks=skin, offsets=zeros((len(skin), 3), subject.offsets))
    return skin, to_numpy(points_of(bare, frames))


def _off_floor(lowest: np.ndarray, fps: float, world: Obstacles) -> np.ndarray:
    """Return an (F,) mask of frames in which the person is on another floor than z = 0.

    ``lowest`` (F,) is the height of the lowest skin in metres. The mask contains ranges that last at least as long as a
    step and have skin below ``-LEVEL_M``, and the frames near them. It contains all frames if the median height is
    below ``-LEVEL_M``, or, without objects, above ``FLOOR_M``.
    """
    level, off = float(np.median(lowest)), np.zeros(len(lowest), bool)
    if level < -LEVEL_M or (level > FLOOR_M and not world.has_objects):
        return ~off
    step = round(SHORTEST_S * fps)
    for first, stop in standing_runs(lowest < -LEVEL_M, fps):
        off[max(first - step, 0) : stop + step] = True
    return off


def _obey(held: np.ndarray, height: np.ndarray, parts: np.ndarray, told: Sequence[UserContact]) -> np.ndarray:
    """Fix the lowest skin in contacts that the user added, and release the skin in contacts that the user removed."""
    added = np.zeros(held.shape, bool)
    for contact in told:
        part = np.ix_(range(contact.first, contact.last + 1), parts == list(CONTACT_PARTS).index(contact.part))
        if not contact.touches:
            held[part] = added[part] = False
        elif height[part].size:
            added[part] = height[part] < height[part].min(axis=1, keepdims=True) + LOWEST_M
            held[part] |= added[part]
    return added


def _shifts(height: np.ndarray, held: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return the height (F, S) in metres of the lowest held point of each point's body part, 0 if none is held."""
    shifts = np.zeros(height.shape)
    for part in np.unique(parts):
        own = parts == part
        low = np.where(held[:, own], height[:, own], np.inf).min(axis=1)
        shifts[:, own] = np.where(np.isfinite(low), low, 0.0)[:, None]
    return shifts


def _anchors(place: np.ndarray, held: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Return mean positions (F, S, 3) over each contact, or over its ``fixed`` frames, if any."""
    anchors = np.zeros(place.shape)
    for k in range(held.shape[1]):
        for first, last in true_runs(held[:, k]):
            run = slice(first, last + 1)
            sure = fixed[run] if fixed[run].any() else slice(None)
            anchors[run, k] = place[run, k][sure].mean(axis=0)
    return anchors


def _of_foot(name: str) -> bool:
    return name.split("_", 1)[-1] in ("ankle", "big_toe", "small_toe", "heel", "foot")


def _low_vertices(
    subject: Subject, frames: PosedFrames, near: np.ndarray, fps: float, world: Obstacles, told: Sequence[UserContact]
) -> np.ndarray:
    """Select the skin vertices that are on the soles, near a surface, or lowest on a part with a user-added contact.

    The vertices are at least ``SPACING_M`` apart at rest. The lowest ones are selected first.
    """
    body, stride = subject.body, max(1, round(SAMPLE_S * fps))
    rest, parts = body.v_template, parts_of_skin(body)
    soles = (parts >= 0) & (parts < FEET) & (rest[:, 1] < rest[:, 1].min() + SOLE_M)
    lowest = np.where(soles, 0.0, np.inf)

    def meshes(numbers: np.ndarray) -> Iterator[np.ndarray]:
        for start in range(0, len(numbers), 64):
            some = frames.select(index(numbers[start : start + 64], frames.transl))
            pose = (to_numpy(part) for part in (some.root, some.local, some.transl))
            yield pose_mesh(body, to_numpy(subject.betas), *pose)

    for mesh in meshes(near[::stride]):
        height = world.nearest(mesh, REACH_M)[0]
        lowest = np.minimum(lowest, height.min(axis=0))
    for contact in told:
        own = parts == list(CONTACT_PARTS).index(contact.part)
        for mesh in meshes(np.arange(contact.first, contact.last + 1)[::stride]):
            known = world.nearest(mesh, NEAR_M)[0][:, own]
            height = np.where(np.isfinite(known).all(axis=1, keepdims=True), known, mesh[:, own, 2])
            above = height - height.min(axis=1, keepdims=True)
            lowest[own] = np.minimum(lowest[own], above.min(axis=0))
    lowest[parts < 0] = np.inf
    taken: list[int] = []
    for vertex in np.argsort(lowest, kind="stable"):
        if lowest[vertex] > REACH_M:
            break
        if (np.linalg.norm(rest[taken] - rest[vertex], axis=-1) > SPACING_M).all():
            taken.append(int(vertex))
    return np.array(taken, int)
