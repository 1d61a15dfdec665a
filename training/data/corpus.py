"""The training corpus: recorded clips as body rotations at 30 Hz, split by subject, without near-duplicates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from solver_backend.body.joint_limits import JOINT_LIMITS, excess_deg, from_swing_and_twist, swing_and_twist
from solver_backend.body.rest_skeleton import BODY_MIRROR
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS
from solver_backend.geometry.rotations import exp_so3
from training.data.points import rotation_points
from training.data.sources.clips import KEYED, UNKNOWN, Clip

HELD_OUT = frozenset({"03", "08", "13", "60_61", "ui_prmd_s07", "ui_prmd_s08"})  # Subjects not used in training.
NEAR_REPEAT_M = 0.012  # Poses closer than this are repeats. The distance is the root mean square over the joints.
KEYED_REPEATS = 4
"""Weight of each pose of a hand-keyed animation. There are few of these poses, and recordings lack some of them."""
SIMPLIFIED = "jump"  # Source whose skeleton has no separate hands, toes and head.
SIMPLIFIED_EVERY = 4  # Of its distinct poses, only every n-th is used.
_SAME_TAKE_M = 0.004  # Poses closer than this, in metres, come from the same frame. Chosen by hand.


@dataclass(frozen=True)
class Corpus:
    """Concatenated clips of the training side or the validation side."""

    rotations: np.ndarray  # (N, 21, 3, 3) local rotations, float32.
    clip_start: np.ndarray  # (N,) first frame of the clip that each frame belongs to.
    clip_end: np.ndarray  # (N,) end (exclusive) of the clip that each frame belongs to.
    distinct: np.ndarray  # (D,) frames without near-repeats. Hand-keyed frames occur several times.
    names: tuple[str, ...]
    subjects: tuple[str, ...]  # Subject of each clip.
    root: np.ndarray  # (N, 3, 3) float32, pelvis rotation since the T-pose, Y up, NaN if unknown.

    @property
    def num_frames(self) -> int:
        """Number N of frames, including near-repeats."""
        return len(self.rotations)

    def some_distinct(self, most: int) -> np.ndarray:
        """Return about ``most`` of the distinct poses, at equal steps, as rotations (n, 21, 3, 3)."""
        return self.rotations[self.distinct[:: max(1, len(self.distinct) // most)]]

    @property
    def sources(self) -> np.ndarray:
        """(N,) source of each frame: the part of its clip's name before the slash."""
        return np.array([name.split("/")[0] for name in self.names])[self._clip]

    @property
    def people(self) -> np.ndarray:
        """(N,) index of the person in each frame.

        Each hand-keyed clip counts as a separate person, because its poses do not repeat in other clips. All unknown
        people in one source count as the same person.
        """
        named = zip(self.names, self.subjects, strict=True)
        who = [name if who == KEYED else name.split("/")[0] if who == UNKNOWN else who for name, who in named]
        return np.unique(who, return_inverse=True)[1][self._clip]

    @property
    def _clip(self) -> np.ndarray:
        starts, clip = np.unique(self.clip_start, return_inverse=True)
        assert len(starts) == len(self.names)
        return clip


def split_corpus(clips: list[Clip], held_out_subjects: frozenset[str] = HELD_OUT) -> tuple[Corpus, Corpus]:
    """Split clips into a training and a validation corpus. Unnamed clips that repeat a held-out take are dropped.

    Raises:
        FileMissing: one side has no recordings.
    """
    held_out = [clip for clip in clips if clip.subject in held_out_subjects]
    rest = [clip for clip in clips if clip.subject not in held_out_subjects]
    check_sides(rest, held_out, held_out_subjects)
    known = _features(np.concatenate([clip.rotations for clip in held_out]))
    kept = [clip for clip in rest if clip.subject != UNKNOWN or not _repeats(clip, known)]
    return build_corpus(kept), build_corpus(held_out)


def absent_subjects(clips: list[Clip], held_out_subjects: frozenset[str] = HELD_OUT) -> tuple[str, ...]:
    """Return the held-out subjects that have no clips, and so do not contribute to the results."""
    return tuple(sorted(held_out_subjects - {clip.subject for clip in clips}))


def check_sides(training: list[Clip], validation: list[Clip], held_out_subjects: frozenset[str] = HELD_OUT) -> None:
    """Check that both the training side and the validation side contain people.

    Raises:
        FileMissing: there is no person to train on, or none to validate on.
    """
    if not validation:
        raise FileMissing(
            f"The recordings have none of the validation subjects ({', '.join(sorted(held_out_subjects))}).",
            hint="For --data, give the folder that contains motion_cmu with all of its subjects.",
        )
    if not training:
        raise FileMissing(
            f"The recordings have only validation subjects: {', '.join(sorted({c.subject for c in validation}))}.",
            hint="For --data, give the folder that contains motion_cmu with all of its subjects.",
        )


def build_corpus(clips: list[Clip]) -> Corpus:
    """Concatenate clips to a corpus, and find its distinct poses."""
    rotations = np.concatenate([clip.rotations for clip in clips])
    ends = np.cumsum([len(clip.rotations) for clip in clips])
    lengths = [len(clip.rotations) for clip in clips]
    starts = np.repeat(ends - lengths, lengths)
    distinct = distinct_poses(_features(rotations), NEAR_REPEAT_M)
    keyed = np.repeat([clip.subject == KEYED for clip in clips], lengths)
    simplified = np.repeat([clip.name.startswith(f"{SIMPLIFIED}/") for clip in clips], lengths)[distinct]
    distinct = distinct[~simplified | (np.cumsum(simplified) % SIMPLIFIED_EVERY == 0)]
    distinct = np.repeat(distinct, np.where(keyed[distinct], KEYED_REPEATS, 1))
    names, subjects = zip(*((clip.name, clip.subject) for clip in clips), strict=True)
    root = np.concatenate([_root(clip) for clip in clips])
    return Corpus(rotations, starts, np.repeat(ends, lengths), distinct, names, subjects, root)


def _root(clip: Clip) -> np.ndarray:
    return np.full((len(clip.rotations), 3, 3), np.nan, np.float32) if clip.root is None else clip.root


def distinct_poses(features: np.ndarray, radius: float, block: int = 1024) -> np.ndarray:
    """Select poses so that each pose is within ``radius`` of a selected one, and return their indices.

    Uses leader clustering in temporal order.

    Args:
        features: (N, d) features, compared by Euclidean distance.
        radius: largest distance from any pose to the nearest kept pose.
        block: number of poses to compare at a time.
    """
    kept: list[np.ndarray] = []
    leaders = np.zeros((0, features.shape[1]), dtype=features.dtype)
    for first in range(0, len(features), block):
        part = np.arange(first, min(first + block, len(features)))
        for chunk in range(0, len(leaders), 16384):
            part = part[_nearest(features[part], leaders[chunk : chunk + 16384]) > radius]
        near = _squared(features[part], features[part]) <= radius**2
        alive = np.ones(len(part), dtype=bool)
        for i in range(len(part)):
            if alive[i]:
                alive[i + 1 :] &= ~near[i, i + 1 :]
        kept.append(part[alive])
        leaders = np.concatenate((leaders, features[part[alive]]))
    return np.concatenate(kept)


def _features(rotations: np.ndarray) -> np.ndarray:
    """Return scaled joint positions (N, 69). Their Euclidean distance is the RMS distance of 23 joints in metres."""
    joints = rotation_points(rotations.astype(np.float32))[:, 1:NUM_JOINTS]
    return (joints / np.sqrt(joints.shape[1])).reshape(len(joints), -1)


def _repeats(clip: Clip, known: np.ndarray) -> bool:
    """Return whether most frames of a clip also occur in ``known``."""
    return bool(np.mean(_nearest(_features(clip.rotations[::5]), known) < _SAME_TAKE_M) > 0.5)


def _nearest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    if not len(a) or not len(b):
        return np.full(len(a), np.inf)
    return np.sqrt(np.maximum(_squared(a, b).min(axis=1), 0.0))


def _squared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * a).sum(1)[:, None] - 2.0 * a @ b.T + (b * b).sum(1)[None, :]


_MIRRORED = torch.tensor(BODY_MIRROR)
_FLIP = torch.tensor([[1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
EXCHANGED_JOINTS: tuple[tuple[int, ...], ...] = (
    SMPL.group("left_arm"),
    SMPL.group("right_arm"),
    SMPL.both("hip", "knee", "ankle", "foot"),
    SMPL.group("left_leg"),
    SMPL.group("right_leg"),
    SMPL.numbers("neck", "head"),
    SMPL.numbers("spine1", "spine2", "spine3"),
)
"""Joints that poses exchange together: left arm, right arm, both legs, left leg, right leg, head, spine."""
EXCHANGE_CHANCE = (0.25, 0.25, 0.3, 0.15, 0.15, 0.3, 0.15)
CLEARANCE_M = 0.07
"""Smallest distance in metres between an arm joint of an exchanged pose and the bones of trunk, head and legs."""
LIMIT_SHARE = (0.6, 1.0)  # Range of the position to which a joint is moved, as fractions of its limits.
MOVED_JOINTS = 2  # Number of joints that are moved towards their limits in each window.
_ALLOWED_DEG = 10.0  # Degrees by which a joint may exceed its limits. Chosen by hand.
_REACH = torch.as_tensor(JOINT_LIMITS).abs().amax(dim=(-1, -2), keepdim=False)  # Largest angle of each joint, radians.
_COLLARS, _WRISTS = SMPL.both("collar"), SMPL.both("wrist")
_MIDLINE = SMPL.numbers("spine1", "spine2", "spine3", "neck", "head")
_ARM_POINTS = SMPL.both("elbow", "wrist", "hand")
"""SMPL's elbows, wrists and hands."""
_BODY_BONES = tuple(
    SMPL.numbers(*ends)
    for ends in (
        ("pelvis", "spine2"),
        ("spine2", "neck"),
        ("left_hip", "left_knee"),
        ("right_hip", "right_knee"),
        ("left_knee", "left_ankle"),
        ("right_knee", "right_ankle"),
        ("neck", "head"),
    )
)
"""Pairs of SMPL joints that form the bones of trunk, head and legs."""


def middle_frame(windows: torch.Tensor) -> int:
    """Return the index of the middle key in (B, K, ...) windows: the second of four frames, or the only one."""
    return (windows.shape[1] - 1) // 2


def mirrored(rotations: torch.Tensor) -> torch.Tensor:
    """Mirror poses (..., 21, 3, 3) left to right: ``R' = S R S`` with ``S = diag(-1, 1, 1)``."""
    return rotations[..., _MIRRORED, :, :] * _FLIP.to(rotations)


def maybe_mirrored(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Mirror about half of the windows (B, K, 21, 3, 3), chosen at random."""
    chosen = torch.rand(len(windows), 1, 1, 1, 1, generator=generator) < 0.5
    return torch.where(chosen, mirrored(windows), windows)


def exchanged_limbs(windows: torch.Tensor, generator: torch.Generator, chance: float) -> torch.Tensor:
    """Replace limbs in some windows (B, K, 21, 3, 3) by limbs of other windows, possibly mirrored."""
    count = len(windows)
    any_chance = torch.rand(count, generator=generator) < chance
    out, windows = windows.clone(), maybe_mirrored(windows, generator)
    for limb, likely in zip(EXCHANGED_JOINTS, EXCHANGE_CHANCE, strict=True):
        donor = torch.randperm(count, generator=generator)
        take = (torch.rand(count, generator=generator) < likely) & any_chance
        columns = torch.tensor([j - 1 for j in limb])
        taken = torch.where(take[:, None, None, None, None], windows[donor][:, :, columns], out[:, :, columns])
        out[:, :, columns] = taken
    return out


def varied_joints(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Rotate each joint by a random angle (collars 5°, wrists 12°, head and spine 3°, other joints 1.5°)."""
    sigma = torch.full((NUM_BODY_JOINTS, 1), math.radians(1.5))
    for joints, degrees in (_COLLARS, 5.0), (_WRISTS, 12.0), (_MIDLINE, 3.0):
        sigma[[joint - 1 for joint in joints]] = math.radians(degrees)
    strength = torch.rand(len(windows), 1, 1, generator=generator) * 1.4
    turn = exp_so3(torch.randn(len(windows), NUM_BODY_JOINTS, 3, generator=generator) * sigma * strength)
    return torch.matmul(windows, turn[:, None])


def near_limits(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Move two joints in each window (B, K, 21, 3, 3) towards an end of one of their ranges.

    One of the joint's three angles (swing across the bone, or twist about it) gets 60 to 100 % of its range on either
    side, in the middle frame of the window. The joint keeps its motion within the window.
    """
    count, frames = windows.shape[:2]
    if count == 0:
        return windows
    joint = torch.stack([torch.randperm(NUM_BODY_JOINTS, generator=generator)[:MOVED_JOINTS] for _ in range(count)])
    angle = torch.randint(3, (count, MOVED_JOINTS), generator=generator)
    side = torch.randint(2, (count, MOVED_JOINTS), generator=generator)
    low, high = LIMIT_SHARE
    share = low + (high - low) * torch.rand(count, MOVED_JOINTS, generator=generator)
    target = share * torch.as_tensor(JOINT_LIMITS)[joint, angle, side].to(share.dtype)
    angles = swing_and_twist(windows.flatten(0, 1)).unflatten(0, (count, frames))
    row = torch.arange(count)[:, None]
    moving = angles[row, :, joint, angle]
    angles[row, :, joint, angle] = moving + (target - moving[..., middle_frame(windows)])[..., None]
    moved = from_swing_and_twist(within_reach(angles).flatten(0, 1))
    out = windows.clone()
    out[row, :, joint] = moved.unflatten(0, (count, frames))[row, :, joint]
    return out


def within_reach(angles: torch.Tensor) -> torch.Tensor:
    """Scale a joint's angles (..., 21, 3) in radians down if their norm exceeds the joint's largest limit."""
    length, reach = torch.linalg.vector_norm(angles, dim=-1), _REACH.to(angles.dtype)
    return angles * (reach / torch.maximum(length, reach))[..., None]


def beyond_reach(poses: torch.Tensor) -> torch.Tensor:
    """Return a mask (N,) of the poses (N, 21, 3, 3) with a joint more than 10 degrees beyond its range."""
    return (excess_deg(poses) > _ALLOWED_DEG).any(dim=1)


def penetrating(joints: torch.Tensor) -> torch.Tensor:
    """Return a mask (N,) of the poses, given by joints (N, 24, 3), with an arm joint inside trunk, head or legs."""
    points = joints[:, list(_ARM_POINTS)]
    inside = torch.zeros(len(joints), dtype=torch.bool)
    for a, b in _BODY_BONES:
        start, bone = joints[:, None, a], joints[:, None, b] - joints[:, None, a]
        share = ((points - start) * bone).sum(-1, keepdim=True) / (bone * bone).sum(-1, keepdim=True)
        distance = torch.linalg.vector_norm(points - start - share.clamp(0.0, 1.0) * bone, dim=-1)
        inside |= (distance < CLEARANCE_M).any(dim=1)
    return inside


LIMBS: tuple[tuple[int, ...], ...] = (
    *map(SMPL.group, ("left_leg", "right_leg", "left_arm", "right_arm")),
    SMPL.numbers("spine1", "spine2", "spine3"),
    SMPL.numbers("neck", "head"),
)
"""Joints that are rotated together: legs, arms, spine, neck and head."""
LIMB_CHANCE = 0.4  # Probability that a limb in a window is rotated. At least one is.
LIMB_SPREAD = (0.05, 0.3)
"""Smallest and largest standard deviation of a rotated joint's angles, relative to their ranges. Drawn per window."""
ENDS: tuple[int, ...] = SMPL.both("ankle", "foot", "wrist")
"""Ankles, toes and wrists. In recordings, they are rarely at the ends of their ranges."""
END_CHANCE = 0.5  # Probability that such a joint in a window is moved.
_LIMITS = torch.as_tensor(JOINT_LIMITS, dtype=torch.float32)


def limbs_turned(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Rotate limbs in windows (B, K, 21, 3, 3) within their joint limits, by the same angles in all frames of a window.

    Each of a joint's three angles (swing across the bone and twist about it) changes by a normal draw, with a standard
    deviation of ``LIMB_SPREAD`` times the range. The result is limited to the range.
    """
    count = len(windows)
    chosen = torch.rand(count, len(LIMBS), generator=generator) < LIMB_CHANCE
    chosen[torch.arange(count), torch.randint(len(LIMBS), (count,), generator=generator)] = True
    joints = torch.zeros(count, NUM_BODY_JOINTS, dtype=torch.bool)
    for number, limb in enumerate(LIMBS):
        joints[:, [j - 1 for j in limb]] = chosen[:, number, None]
    low, high = LIMB_SPREAD
    spread = low + (high - low) * torch.rand(count, 1, 1, generator=generator)
    turn = spread * (_LIMITS[..., 1] - _LIMITS[..., 0]) * torch.randn(count, NUM_BODY_JOINTS, 3, generator=generator)
    return _moved(windows, turn, joints)


def ends_reaching(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Rotate ankles, toes and wrists in windows (B, K, 21, 3, 3) by a random angle, up to an end of their range.

    One of the joint's three angles changes, to either side. It reaches the drawn angle in the window's middle frame.
    """
    count, ends = len(windows), torch.tensor(ENDS) - 1
    joints = torch.zeros(count, NUM_BODY_JOINTS, dtype=torch.bool)
    joints[:, ends] = torch.rand(count, len(ENDS), generator=generator) < END_CHANCE
    angle = torch.randint(3, (count, len(ENDS)), generator=generator)
    side = torch.randint(2, (count, len(ENDS)), generator=generator)
    share = torch.rand(count, len(ENDS), generator=generator)
    here = swing_and_twist(windows[:, middle_frame(windows)])[:, ends].gather(2, angle[..., None])[..., 0]
    turn = torch.zeros(count, NUM_BODY_JOINTS, 3)
    row = torch.arange(count)[:, None]
    turn[row, ends, angle] = share * (_LIMITS[ends, angle, side] - here)
    return _moved(windows, turn, joints)


def _moved(windows: torch.Tensor, turn: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
    """Add ``turn`` (B, 21, 3), in radians, to the angles of the chosen joints (B, 21), within their limits."""
    count, frames = windows.shape[:2]
    angles = swing_and_twist(windows.flatten(0, 1)).unflatten(0, (count, frames)) + turn[:, None]
    angles = within_reach(angles.clamp(_LIMITS[..., 0], _LIMITS[..., 1]))
    moved = from_swing_and_twist(angles.flatten(0, 1)).unflatten(0, (count, frames))
    return torch.where(joints[:, None, :, None, None], moved, windows)


MAX_SPACING = 9  # Largest distance between adjacent keys in frames at 30 Hz (0.3 s).


@dataclass(frozen=True)
class WindowBatch:
    """A batch of B windows: short pieces of motion with three keys and one frame between the keys."""

    rotations: torch.Tensor  # (B, 4, 21, 3, 3) rotations of the keys at times 0, 1/2 and 1, and of another frame.
    time: torch.Tensor  # (B,) time of the other frame, 0..1.

    def to(self, device: torch.device) -> WindowBatch:
        """Copy the batch to a device."""
        return WindowBatch(self.rotations.to(device), self.time.to(device))


@dataclass(frozen=True)
class WindowSampler:
    """Draws augmented windows of motion around the distinct poses of a corpus."""

    rotations: torch.Tensor
    clip_start: torch.Tensor
    clip_end: torch.Tensor
    distinct: torch.Tensor
    exchange_chance: float = 0.6
    variation_chance: float = 0.7
    limit_chance: float = 0.15
    turned_chance: float = 0.0  # Fraction of windows with limbs rotated within anatomical limits.
    end_chance: float = 0.0  # Fraction of windows with ankles, toes and wrists rotated towards their limits.

    @classmethod
    def of(cls, corpus: Corpus, *, turned_chance: float = 0.0, end_chance: float = 0.0) -> WindowSampler:
        """Create a sampler for a corpus, and convert the corpus' arrays to torch tensors."""
        rotations, start, end, distinct = (
            torch.as_tensor(np.ascontiguousarray(a))
            for a in (corpus.rotations, corpus.clip_start, corpus.clip_end, corpus.distinct)
        )
        return cls(rotations, start, end, distinct, turned_chance=turned_chance, end_chance=end_chance)

    def draw(self, count: int, generator: torch.Generator) -> WindowBatch:
        """Draw ``count`` augmented windows. The random spacing of a window's frames is reduced at the end of a clip."""
        middle = self.distinct[torch.randint(len(self.distinct), (count,), generator=generator)]
        room = torch.minimum(middle - self.clip_start[middle], self.clip_end[middle] - 1 - middle)
        spacing = torch.minimum(torch.randint(1, MAX_SPACING + 1, (count,), generator=generator), room)
        offset = torch.randint(-MAX_SPACING, MAX_SPACING + 1, (count,), generator=generator)
        offset = torch.where(offset.abs() <= spacing, offset, offset % (2 * spacing + 1) - spacing)
        time = 0.5 + 0.5 * offset / spacing.clamp_min(1)
        frames = torch.stack((middle - spacing, middle, middle + spacing, middle + offset), dim=1)
        return WindowBatch(self._augment(self.rotations[frames], generator), time.to(torch.float32))

    def draw_poses(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """Draw ``count`` augmented poses (count, 21, 3, 3), without their motion."""
        chosen = self.distinct[torch.randint(len(self.distinct), (count,), generator=generator)]
        return self._augment(self.rotations[chosen, None], generator)[:, 0]

    def _augment(self, windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        plain = maybe_mirrored(windows, generator)
        mixed = exchanged_limbs(plain, generator, self.exchange_chance)
        vary = torch.rand(len(mixed), 1, 1, 1, 1, generator=generator) < self.variation_chance
        mixed = torch.where(vary, varied_joints(mixed, generator), mixed)
        moved = torch.zeros(len(mixed), dtype=torch.bool)
        for chance, move in (
            (self.turned_chance, limbs_turned),
            (self.end_chance, ends_reaching),
            (self.limit_chance, near_limits),
        ):
            chosen = torch.rand(len(mixed), generator=generator) < chance
            mixed[chosen] = move(mixed[chosen], generator)
            moved |= chosen
        middle = mixed[:, middle_frame(mixed)]
        bad = penetrating(rotation_points(middle)[:, :NUM_JOINTS])
        bad[moved] |= beyond_reach(middle[moved])
        return torch.where(bad[:, None, None, None, None], plain, mixed)
