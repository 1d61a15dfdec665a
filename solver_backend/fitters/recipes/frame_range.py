"""Solve some frames of an earlier motion again, and join them to the frames outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from solver_backend.exchange.contact_parts import CONTACT_PARTS, FEET
from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import build_motion
from solver_backend.fitters.hands.solve_hands import with_fingers_of, without_fingers
from solver_backend.fitters.keyframes.frame_range import FrameRange, UserContact
from solver_backend.fitters.keyframes.initial_keys import initial_keys, keys_of_frames, window_of
from solver_backend.fitters.keyframes.optimise import Schedule, joint_covariance, noise_inflation, solve_keys
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, range_layout
from solver_backend.fitters.model.subject import (
    OFF_THE_MANIFOLD,
    ON_THE_MANIFOLD,
    Keyframes,
    PosedFrames,
    Subject,
    hemisphere_aligned,
    points_of,
)
from solver_backend.fitters.person_shape import Contacts, ShapePrior, find_contacts, refit_shape, with_learned_noise
from solver_backend.fitters.problem import Problem, Solution, SolvedFrames, noted
from solver_backend.fitters.recipes.bundle import PEOPLE, Bundle, Pass, holds_skin, touching_parts, world_of
from solver_backend.fitters.rest_parts import rest_parts
from solver_backend.fitters.skin_contacts import SkinContacts, find_skin_contacts
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.obstacles import Obstacles
from solver_backend.geometry.rotations import exp_so3, log_so3, quat_from_matrix
from solver_backend.geometry.small_matrices import mean_sigma, packed
from solver_backend.types import FLAG_UNSURE, Motion

MOVED_M = 0.02  # A joint that a pin moves farther than this is uncertain near the pinned frame. Chosen by hand.
DOUBTFUL_M = 0.046  # Smallest standard deviation of such a joint: confidence 0.3, as in an unsure frame.
_DIAGONAL = [0, 3, 5]  # Entries xx, yy and zz of ``packed`` matrices.


def express_pin_doubts(again: Motion, before: Motion, frame_range: FrameRange, frames: np.ndarray) -> Motion:
    """Replace the flag of frames that are unsure because of a pin by larger deviations of the moved joints.

    A pinned pose contradicts the measurements, so the neighbouring frames are flagged as unsure. Pinned frames lose all
    flags.
    """
    pinned = np.array(sorted({pin.frame for pin in frame_range.pins}), dtype=int)
    if not len(pinned) or again.flags is None or again.joints is None or before.joints is None:
        return again
    flags, known = again.flags.copy(), np.zeros_like(again.flags) if before.flags is None else before.flags
    new = np.zeros(len(flags), bool)
    new[frames] = (flags[frames] & FLAG_UNSURE > 0) & (known[frames] & FLAG_UNSURE == 0)
    new[pinned] = False
    moved = np.linalg.norm(again.joints - before.joints, axis=-1) > MOVED_M
    moved[~new] = False
    flags[moved.any(axis=1)] &= ~np.uint8(FLAG_UNSURE)
    flags[pinned] = 0
    covariance, sigma = again.joint_covariance, again.joint_sigma
    if covariance is not None and sigma is not None:
        missing = np.where(moved, np.maximum(DOUBTFUL_M**2 - np.square(sigma), 0.0), 0.0)
        covariance = covariance.copy()
        covariance[..., _DIAGONAL] += missing[..., None]
        sigma = np.where(moved, mean_sigma(covariance), sigma)
    return replace(again, flags=flags, joint_covariance=covariance, joint_sigma=sigma)


@dataclass(frozen=True)
class SolvedRange:
    """Frame range that was solved again, with the windows on both sides of it."""

    frame_range: FrameRange
    layout: KeyframeLayout
    free: np.ndarray  # (2N + 1,) bool: keys that moved.
    frames: PosedFrames  # Poses in the layout's frames.
    contacts: Contacts | None  # Over the whole take, if planted feet were detected.
    skin: SkinContacts | None  # Over the whole take, if other parts touch the floor or the user added contacts.
    status: str  # How the last pass ended.

    @property
    def moved(self) -> np.ndarray:
        """Numbers of the frames with new poses: the whole range, except range ends without pins."""
        wanted, frames = self.frame_range, self.layout.frames
        inside = (frames >= wanted.first) & (frames <= wanted.last)
        pinned = {pin.frame for pin in wanted.pins}
        fixed = set(self.layout.key_times[~self.free]) & {wanted.first, wanted.last} - pinned
        return frames[inside & ~np.isin(frames, list(fixed))]


_OF_THE_TAKE = ("betas", "offsets", "marker_sigma")  # Arrays in a motion that do not have one value per frame.


def contacts_in_place(
    problem: Problem,
    subject: Subject,
    before: PosedFrames,
    frames: PosedFrames,
    layout: KeyframeLayout,
    frame_range: FrameRange,
    world: Obstacles,
    *,
    detects: bool,
    every: bool,
) -> tuple[Contacts | None, SkinContacts | None]:
    """Find the contacts in a take after a range was solved again, including the user's changes.

    ``before`` are the take's earlier poses, and ``frames`` the new poses in the layout's frames. If ``detects`` is
    false, the feet have only the contacts that the user added. If ``every`` is false, the other parts have only the
    contacts that the user added.
    """
    whole = PosedFrames(*(_copied(getattr(before, name)) for name in ("root", "local", "transl")))
    for name in ("root", "local", "transl"):
        getattr(whole, name)[layout.frames] = getattr(frames, name)
    points, names = to_numpy(points_of(subject, whole)), subject.landmarks.names
    number, told = np.arange(problem.num_frames), frame_range.contacts
    fixed = (number < frame_range.first) | (number > frame_range.last)
    contacts = find_contacts(points, names, problem.fps, fixed) if detects else None
    skin = find_skin_contacts(subject, whole, points, problem.fps, world, told, fixed, detects=every)
    if skin is not None and contacts is not None:
        loose = skin.touches[:, :FEET]
        for contact in told:
            if (foot := list(CONTACT_PARTS).index(contact.part)) < FEET:
                loose[contact.first : contact.last + 1, foot] = True
        contacts = contacts.without_feet(names, loose)
    return contacts, skin


def trusted_world(settings: SolveSettings, motion: Motion) -> Obstacles:
    """Return the floor and objects, except those that views contradicted in the earlier solve."""
    found = read_diagnostics(motion.provenance.get("diagnostics"))
    refused = [item.values.get("surface") for item in found if item.code == "surface_contradicted"]
    if not set(refused) - {PEOPLE}:
        return world_of(settings)
    return Obstacles.floor() if "objects" in refused else Obstacles.floor().without_floor


def with_earlier_contacts(frame_range: FrameRange, motion: Motion) -> FrameRange:
    """Put the user's contacts from earlier solves before the range's own contacts, unless the range forgets them."""
    kept = list[UserContact]()
    for entry in () if frame_range.forgets else motion.provenance.get("resolved", ()):
        # Each solve recorded all contacts in its frames, including those from earlier solves.
        before, after = (0, entry["first"] - 1), (entry["last"] + 1, motion.num_frames - 1)
        kept = [*_within(kept, *before), *_within(kept, *after)]
        kept += [UserContact.from_dict(item, "resolve") for item in entry.get("contacts", ())]
    return replace(frame_range, contacts=(*_within(kept, frame_range.first, frame_range.last), *frame_range.contacts))


def _within(contacts: list[UserContact], first: int, last: int) -> list[UserContact]:
    """Cut contacts to the frames from ``first`` to ``last``."""
    cut = (replace(c, first=max(c.first, first), last=min(c.last, last)) for c in contacts)
    return [contact for contact in cut if contact.first <= contact.last]


def _as_told(motion: Motion, told: Sequence[UserContact]) -> np.ndarray:
    """Return an (F, 11) mask of touching parts in an earlier motion, including the user's changes."""
    touches = np.zeros((motion.num_frames, len(CONTACT_PARTS)), bool)
    if motion.touches is not None:
        touches |= motion.touches
    elif motion.contacts is not None:
        touches[:, :FEET] = motion.contacts
    for contact in told:
        touches[contact.first : contact.last + 1, list(CONTACT_PARTS).index(contact.part)] = contact.touches
    return touches


def frames_in_place(
    problem: Problem, subject: Subject, motion: Motion, before: PosedFrames, solved: SolvedRange, covariance: np.ndarray
) -> SolvedFrames:
    """Insert the new poses of the moved frames into the take's earlier poses.

    ``before`` are the earlier poses. ``covariance`` (n, J + S, 6) contains joints and segment rotations in the layout's
    frames (see ``joint_covariance``, ``packed``).
    """
    layout, wanted, moved = solved.layout, solved.frame_range, solved.moved
    whole = PosedFrames(*(_copied(getattr(before, n)) for n in ("root", "local", "transl")))
    for name in ("root", "local", "transl"):
        getattr(whole, name)[moved] = getattr(solved.frames, name)[moved - layout.bounds[0]]
    joints, everywhere = len(subject.body.recorded_joints), []
    parts = (covariance[:, :joints], covariance[:, joints:])
    for known, part in zip((motion.joint_covariance, motion.turn_covariance), parts, strict=True):
        whole_part = np.tile(part.mean(axis=0), (problem.num_frames, 1, 1)) if known is None else known.copy()
        whole_part[layout.frames] = part
        everywhere.append(whole_part)
    key_times = layout.key_times[(layout.key_times >= wanted.first) & (layout.key_times <= wanted.last)]
    contacts, touches = touching_parts(solved.contacts, solved.skin, subject.landmarks.names)
    if solved.contacts is None and wanted.contacts:
        touches = _as_told(motion, wanted.contacts)
        contacts = None if motion.contacts is None else touches[:, :FEET]
    frames = SolvedFrames(subject, whole, key_times, everywhere[0], everywhere[1], contacts, touches)
    return rest_parts(problem.measurements, frames, [pin.frame for pin in wanted.pins])


def spliced(problem: Problem, motion: Motion, solved: SolvedRange, frames: SolvedFrames, scale: float) -> Motion:
    """Replace the moved frames in the earlier motion. Other frames do not change.

    Raises:
        MotionInvalid: the motion has other views, keypoints or markers than the recording.
    """
    wanted, moved = solved.frame_range, solved.moved
    again = build_motion(problem.measurements, frames, scale=scale, provenance={})
    again = express_pin_doubts(again, motion, wanted, moved)
    values: dict[str, Any] = {}
    for field in fields(Motion):
        old, new = getattr(motion, field.name), getattr(again, field.name)
        if field.name == "touches" and new is not None and old is None:
            old = np.zeros_like(new)
            old[:, :FEET] = False if motion.contacts is None else motion.contacts
        if isinstance(old, np.ndarray) and isinstance(new, np.ndarray) and field.name not in _OF_THE_TAKE:
            _require_alike(field.name, old, new)
            values[field.name] = old.copy()
            index = (slice(None), moved) if field.name == "reprojection_px" else moved
            values[field.name][index] = new[index]
    entry = {"first": wanted.first, "last": wanted.last, "pins": sorted({pin.frame for pin in wanted.pins})}
    entry |= {"contacts": [asdict(contact) for contact in wanted.contacts]} if wanted.contacts else {}
    record = {**motion.provenance, "resolved": [*motion.provenance.get("resolved", []), entry]}
    record |= {"statistics": again.provenance["statistics"], "status": solved.status}
    if solved.skin is not None:
        record = noted(record, solved.skin.notes())
    return replace(motion, **values, provenance=record)


def _require_alike(name: str, old: np.ndarray, new: np.ndarray) -> None:
    if old.shape != new.shape:
        message = f"The motion's {name} has the shape {old.shape}, but this recording gives {new.shape}."
        hint = "Use the recording that the motion was solved from."
        raise MotionInvalid(message, where="motion", hint=hint)


def _copied(values: Array) -> Array:
    return values.copy() if isinstance(values, np.ndarray) else values.clone()


STAGE = "Solving the frame range"


def solve_range(
    problem: Problem,
    subject: Subject,
    motion: Motion,
    frame_range: FrameRange,
    settings: SolveSettings,
    progress: Progress,
) -> tuple[SolvedRange, SolvedFrames]:
    """Solve a frame range in a motion again. Return the range, and the poses in the whole take.

    There are keyframes at the range's ends, at the pins, and at equal distances between them. Pinned keyframes are
    fixed. A fixed window on either side of the range preserves speed and direction. The solve starts both from the
    motion and from fits of single frames, and keeps the better result. Then planted feet are locked. Feet that are also
    planted outside the range keep their position.

    Raises:
        JobInvalid: the frame range is outside the take.
        MotionInvalid: the motion belongs to another take or body.
    """
    _check_same_take(problem, subject, motion)
    frame_range.check(motion.num_frames)
    frame_range = with_earlier_contacts(frame_range, motion)
    progress(STAGE, 0, 3)
    before, sample = PosedFrames.of_motion(motion, subject.betas), problem.sample
    subject = replace(subject, betas=constant(motion.betas, subject.betas))
    window, scale = window_of(motion, problem.frames_of(settings.refine_window)), settings.robust_scale
    sampled, objective = before.select(sample), problem.objective.select(sample)
    learns = not problem.measurements.knows_person
    subject = refit_shape(subject, sampled, objective, scale, ShapePrior(free_betas=False, free_offsets=learns))
    layout, moving = range_layout(frame_range, motion.num_frames, window)
    fixed = _pinned(_keys_at(problem, before, layout.key_times), problem, layout, frame_range)
    anew = hemisphere_aligned(_mixed(moving, initial_keys(problem, subject, layout), fixed))
    free = OFF_THE_MANIFOLD if settings.residual_rotations else ON_THE_MANIFOLD
    both = Pass(Schedule((2 * scale, scale), 2 * settings.iterations, tolerance=1e-3), free)
    bundle = Bundle.start(
        problem,
        subject,
        settings,
        layout,
        window,
        fixed,
        both.schedule,
        partial(solve_keys, fixed=~moving),
        keys_of_frames(problem, subject, layout),
    )
    bundle = replace(bundle, data=with_learned_noise(problem, subject, sampled, settings))
    starts = enumerate((fixed, anew))
    found = [both.run(bundle.move(start), partial(progress, STAGE, done, 3)) for done, start in starts]
    best = min(found, key=cost_of)
    detects, every = settings.contacts and learns, holds_skin(problem, settings)
    if detects or every or frame_range.contacts:
        world, finds = trusted_world(settings, motion), {"detects": detects, "every": every}

        def find_touching_parts(bundle: Bundle) -> Bundle:
            posed = bundle.posed.poses
            feet, skin = contacts_in_place(problem, subject, before, posed, layout, frame_range, world, **finds)
            return replace(bundle, contacts=feet, skin=skin)

        last = Pass(Schedule((scale,), settings.iterations, tolerance=1e-3), free, (find_touching_parts,))
        best = last.run(best, partial(progress, STAGE, 2, 3))
    assert best.solution is not None
    frames, status = best.posed.poses, best.solution.convergence.status
    solved = SolvedRange(frame_range, layout, moving, frames, best.contacts, best.skin, status)
    covariance = _covariance(replace(best, contacts=None, skin=None), solved)
    progress(STAGE, 3, 3)
    return solved, frames_in_place(problem, subject, motion, before, solved, covariance)


def cost_of(bundle: Bundle) -> float:
    """Return the cost after the last pass of a bundle."""
    assert bundle.solution is not None
    return bundle.solution.cost


def _covariance(bundle: Bundle, solved: SolvedRange) -> np.ndarray:
    layout, model, keys, scale = solved.layout, bundle.model, bundle.posed.keys, bundle.settings.robust_scale
    data, points = bundle.problem.measurements.term.select(layout.frames), points_of(model.subject, solved.frames)
    inflation = noise_inflation(points, data, scale, max(1, bundle.window // 2))
    system = model.information(layout, keys, scale).with_fixed(~solved.free).block_tridiagonal()
    constant_m = bundle.problem.measurements.source.constant_m(bundle.problem.body.layout.recorded)
    return to_numpy(packed(joint_covariance(model, layout, keys, solved.frames, system, inflation, constant_m)))


def _check_same_take(problem: Problem, subject: Subject, motion: Motion) -> None:
    if motion.num_frames != problem.num_frames or abs(motion.fps - problem.fps) > 1e-3:
        message = (
            f"The motion has {motion.num_frames} frames at {motion.fps:g} fps, but the capture has "
            f"{problem.num_frames} at {problem.fps:g} fps."
        )
        raise MotionInvalid(message, where="resolve", hint="Choose the motion that was solved from this capture.")
    motion.require_body(subject.body.id, subject.body.layout.recorded, where="resolve")


def _keys_at(problem: Problem, poses: PosedFrames, times: np.ndarray) -> Keyframes:
    """Return keyframes with exactly the given poses. Between two frames, a keyframe gets the halfway rotation."""
    early, late = np.floor(times).astype(int), np.ceil(times).astype(int)

    def midway(R: Array) -> Array:
        return R[early] @ exp_so3(0.5 * log_so3(R[early].swapaxes(-1, -2) @ R[late]))

    root, local = midway(poses.root), midway(poses.local)
    z = problem.prior.encode(local)
    residual = log_so3(local @ problem.prior.decode(z).swapaxes(-1, -2))
    transl = 0.5 * (poses.transl[early] + poses.transl[late])
    return hemisphere_aligned(Keyframes(z, quat_from_matrix(root), transl, residual))


def _pinned(keys: Keyframes, problem: Problem, layout: KeyframeLayout, frame_range: FrameRange) -> Keyframes:
    for pin in frame_range.pins:
        index = int(np.flatnonzero(layout.key_times == pin.frame)[0])
        count = keys.residual.shape[1]
        vectors = (pin.global_orient[None], pin.body_pose[: 3 * count].reshape(1, count, 3))
        root, local = (exp_so3(constant(vector, keys.z)) for vector in vectors)
        pose = PosedFrames(root, local, constant(pin.transl[None], keys.z))
        keys = keys.replaced(slice(index, index + 1), _keys_at(problem, pose, np.zeros(1)))
    return hemisphere_aligned(keys)


def _mixed(free: np.ndarray, anew: Keyframes, fixed: Keyframes) -> Keyframes:
    order = np.where(free, np.arange(len(free)), len(free) + np.arange(len(free)))
    return anew.replaced(slice(len(free), len(free)), fixed).select(order)


def solve_again(
    problem: Problem,
    subject: Subject,
    motion: Motion,
    frame_range: FrameRange,
    settings: SolveSettings,
    progress: Progress,
) -> Solution:
    """Solve a frame range of a motion again, with hands. Other frames do not change."""
    from solver_backend.fitters.hands.solve_hands import HandRange, Hands, solve_hands_again

    body = without_fingers(motion)
    solved, frames = solve_range(problem, subject, body, frame_range, settings, progress)
    hands = dict[int, HandRange]()
    for layer in problem.measurements.layers:
        if isinstance(layer, Hands):
            frames, hands = solve_hands_again(layer.shown, frames, motion, frame_range, settings, progress)
    again = spliced(problem, body, solved, frames, settings.robust_scale)
    return Solution(with_fingers_of(again, motion, solved, hands, problem.body), solved.status)
