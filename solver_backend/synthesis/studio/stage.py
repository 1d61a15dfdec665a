"""A shot set up: the person who moves in clothes, the cameras around, the room, and what they wear."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.synthesis.simulation.cast import Person, strange_body
from solver_backend.synthesis.studio.camera_arrays import CameraRing
from solver_backend.synthesis.studio.checked_values import CameraInsideBody, NobodySeen
from solver_backend.synthesis.studio.costume import CornerSums, Costume, draw_outfit, dress
from solver_backend.synthesis.studio.motions import MotionSource, find_motions
from solver_backend.synthesis.studio.person_hands import MovingHands, move_hands, skin_with_hands
from solver_backend.synthesis.studio.room import Room, furnish
from solver_backend.synthesis.studio.spec import Spec, StudioLook, draw_light
from solver_backend.synthesis.studio.z_buffer import in_camera
from solver_backend.types import NUM_BETAS, Cameras, JointSet

_MOST_BETA = 2.5  # Standard deviations of a shape coefficient at most; chosen by hand.


@dataclass(frozen=True)
class Shot:
    """One take of one person before one array."""

    name: str  # Unique in its data set, and a folder's name.
    motion: MotionSource
    person: int
    array: CameraRing
    look: StudioLook

    def rng(self, spec: Spec, stream: str) -> np.random.Generator:
        """Return the source of randomness of one thing in this shot; it depends on seed and names alone."""
        return seeded(spec.seed, self.name, stream)


def seeded(seed: int, *names: str) -> np.random.Generator:
    """Return a source of randomness of a seed and names (SHA-256)."""
    digest = hashlib.sha256("\0".join([str(seed), *names]).encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, np.uint32))


def list_shots(spec: Spec) -> tuple[Shot, ...]:
    """Return all shots of a description, in its order.

    Raises:
        FileMissing: a motion is not there.
    """
    return tuple(_shots(spec, find_motions(list(spec.motions), spec.folder)))


def _shots(spec: Spec, motions: tuple[MotionSource, ...]) -> Iterator[Shot]:
    for motion in motions:
        for person in range(spec.people.count):
            for array in spec.arrays:
                for look in spec.looks:
                    parts = (motion.name, f"person{person:03d}", array.name, look.name)
                    yield Shot("-".join(re.sub(r"[^\w.~+]", "_", part) for part in parts), motion, person, array, look)


def cast(spec: Spec, person: int) -> tuple[Body, np.ndarray]:
    """Return body and (10,) shape of a person, who is the same in every shot.

    Raises:
        BodyInvalid: the body that ships cannot be read.
    """
    rng = seeded(spec.seed, "person", str(person))
    betas = np.clip(spec.people.sigma * rng.normal(size=NUM_BETAS), -_MOST_BETA, _MOST_BETA)
    body = load_body()
    return (strange_body(int(rng.integers(2**31)), body=body) if spec.people.strange else body), betas


CLEARANCE_M = 0.1  # A camera is at least so far from the skin.
_NEAREST = 60  # Frames whose skin is looked at: those whose joints are nearest to the camera.


@dataclass(frozen=True)
class Stage:
    """Everything that stands before the cameras; F frames."""

    shot: Shot
    person: Person
    cameras: Cameras
    costume: Costume
    corners: CornerSums
    room: Room
    outfit: tuple[str, str]
    light: str
    labels: tuple[str, ...]  # M marker names.
    markers: np.ndarray  # (F, M, 3) metres: the markers' middles.
    joints: np.ndarray  # (F, 24, 3) metres.
    hands: MovingHands | None = None  # Fingers that move; None where they rest.

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.person.transl)

    def surface(self, frames: np.ndarray) -> np.ndarray:
        """Return the (n, N, 3) vertices of the dressed person in these frames."""
        skin = self.person.skin(frames) if self.hands is None else skin_with_hands(self.person, self.hands, frames)
        return self.costume.posed(skin, self.corners)


def set_up(spec: Spec, shot: Shot) -> Stage:
    """Return the stage of a shot.

    Raises:
        MocapError: the motion cannot be read.
    """
    body, betas = cast(spec, shot.person)
    person = shot.motion.play(body, betas, spec.fps, spec.frames)
    joints = person.landmarks(JointSet.SMPL_24).points
    middle = 0.5 * (joints[:, 0].min(axis=0) + joints[:, 0].max(axis=0))
    if shot.array.stand is not None:
        move = np.array([*(shot.array.stand - middle[:2]), 0.0])
        person, joints, middle = replace(person, transl=person.transl + move), joints + move, middle + move
    pelvis = joints[:, 0]
    cameras = shot.array.around(middle)
    rng = shot.rng(spec, "scene")
    clothes, hair = draw_outfit(shot.look.clothes, shot.look.hair, rng)
    costume = dress(body, clothes, hair, rng)
    light = draw_light(shot.look.light, shot.rng(spec, "light"))
    room = furnish(pelvis, cameras, shot.look.furniture, shot.look.room, rng)
    labels = marker_layout(spec.markers) if spec.markers else ()
    points = np.zeros((len(pelvis), 0, 3))
    if labels:
        points = posed_markers(person, marker_landmarks(body, labels))
    corners = CornerSums(body.faces, len(body.v_template))
    hands = move_hands(person, spec.fps, shot.rng(spec, "hands")) if spec.hands else None
    return Stage(shot, person, cameras, costume, corners, room, (clothes, hair), light, labels, points, joints, hands)


def posed_markers(person: Person, landmarks: Landmarks, offsets: np.ndarray | None = None) -> np.ndarray:
    """Return (F, M, 3) markers, moved by (M, 3) offsets in their rest frames."""
    return pose_landmarks(
        person.body, landmarks, person.betas, person.orient, person.local, person.transl, offsets=offsets
    ).points


def require_sight(stage: Stage) -> None:
    """Check that a shot can be filmed.

    Raises:
        NobodySeen: no camera sees a joint in any frame.
        CameraInsideBody: a camera is inside the person or closer than ``CLEARANCE_M``.
    """
    seen = np.zeros(len(stage.cameras), dtype=bool)
    for view, size in enumerate(stage.cameras.image_size):
        _, px = in_camera(stage.cameras, view, stage.joints.reshape(-1, 3))
        seen[view] = ((px >= -0.5) & (px < size - 0.5)).all(axis=1).any()
    near = np.linalg.norm(stage.joints[:, None] - stage.cameras.centres[None, :, None], axis=-1).min(axis=2)
    for view in np.flatnonzero(near.min(axis=0) < 0.6).tolist():
        skin = stage.person.skin(np.argsort(near[:, view], kind="stable")[:_NEAREST])
        off = np.linalg.norm(skin - stage.cameras.centres[view], axis=-1).min()
        if off < CLEARANCE_M or _inside(skin, stage.person.body.faces, stage.cameras.centres[view]):
            raise CameraInsideBody(
                f"The camera stands {100 * off:.0f} cm from the person's skin or inside it.",
                where=f"shot {stage.shot.name}, camera {stage.cameras.names[view]}",
                hint="Move the array away from the person's path, or choose another motion.",
            )
    if not seen.any():
        raise NobodySeen(
            "No camera sees the person in any frame.",
            where=f"shot {stage.shot.name}",
            hint="Aim the array at where the person moves; rings and corners do so by themselves.",
        )


def _inside(skin: np.ndarray, faces: np.ndarray, point: np.ndarray) -> bool:
    """Return whether a point lies inside a closed mesh in any of the (n, V, 3) poses: solid angle above half.

    Reference: van Oosterom and Strackee 1983, "The solid angle of a plane triangle".
    """
    for vertices in skin:
        a, b, c = (vertices[faces[:, i]] - point for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        top = (a * np.cross(b, c)).sum(axis=1)
        bottom = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        if np.abs(np.arctan2(top, bottom).sum()) > np.pi:
            return True
    return False
