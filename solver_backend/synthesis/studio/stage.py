"""List the shots of a data set, and prepare each one: person, clothes, cameras and room."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.synthesis.simulation.cast import Person, strange_body
from solver_backend.synthesis.studio.camera_arrays import CameraRing
from solver_backend.synthesis.studio.checked_values import CameraInsideBody, NobodySeen
from solver_backend.synthesis.studio.costume import CornerSums, Costume, draw_outfit, dress
from solver_backend.synthesis.studio.motions import MotionSource, find_motions
from solver_backend.synthesis.studio.person_hands import MovingHands, move_hands, skin_with_hands
from solver_backend.synthesis.studio.room import Room, furnish
from solver_backend.synthesis.studio.spec import Spec, StudioLook, draw_light
from solver_backend.synthesis.studio.z_buffer import in_camera, in_pictures
from solver_backend.types import NUM_BETAS, Cameras, JointSet

_MOST_BETA = 2.5  # Largest absolute shape coefficient in standard deviations. Chosen by hand.
CLEARANCE_M = 0.1  # Smallest distance between a camera and the skin in metres.
_NEAREST = 60  # Number of frames with a skin check: the ones with a joint nearest to the camera.


@dataclass(frozen=True)
class Shot:
    """One motion, performed by one person in front of one camera array."""

    name: str  # Unique name within the data set, also used for the folder.
    motion: MotionSource
    person: int
    array: CameraRing
    look: StudioLook

    def rng(self, spec: Spec, stream: str) -> np.random.Generator:
        """Return a random generator for one purpose (``stream``), seeded by the data set's seed and the shot's name."""
        return seeded(spec.seed, self.name, stream)


def seeded(seed: int, *names: str) -> np.random.Generator:
    """Create a random generator from a seed and names (SHA-256)."""
    digest = hashlib.sha256("\0".join([str(seed), *names]).encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, np.uint32))


def list_shots(spec: Spec) -> tuple[Shot, ...]:
    """List all shots of a description, in order. Raise ``FileMissing`` if a motion does not exist."""
    motions, shots = find_motions(list(spec.motions), spec.folder), []
    for motion, person, array, look in product(motions, range(spec.people.count), spec.arrays, spec.looks):
        parts = (motion.name, f"person{person:03d}", array.name, look.name)
        shots.append(Shot("-".join(re.sub(r"[^\w.~+]", "_", part) for part in parts), motion, person, array, look))
    return tuple(shots)


def cast(spec: Spec, person: int) -> tuple[Body, np.ndarray]:
    """Return a person's body and shape (10,), which are the same in every shot."""
    rng = seeded(spec.seed, "person", str(person))
    betas = np.clip(spec.people.sigma * rng.normal(size=NUM_BETAS), -_MOST_BETA, _MOST_BETA)
    return (strange_body(int(rng.integers(2**31))) if spec.people.strange else load_body()), betas


@dataclass(frozen=True)
class Stage:
    """Person, clothes, cameras and room of a shot over F frames."""

    shot: Shot
    person: Person
    cameras: Cameras
    costume: Costume
    corners: CornerSums
    room: Room
    outfit: tuple[str, str]
    light: str
    labels: tuple[str, ...]  # M marker names.
    markers: np.ndarray  # (F, M, 3) marker centres in metres.
    joints: np.ndarray  # (F, 24, 3) joint positions in metres.
    hands: MovingHands | None = None  # Moving fingers, or None if they are at rest.

    @property
    def num_frames(self) -> int:
        """Number of frames F of the shot."""
        return len(self.person.transl)

    def surface(self, frames: np.ndarray) -> np.ndarray:
        """Return the (n, N, 3) vertices of the dressed person in the given frames."""
        skin = self.person.skin(frames) if self.hands is None else skin_with_hands(self.person, self.hands, frames)
        return self.costume.posed(skin, self.corners)


def set_up(spec: Spec, shot: Shot) -> Stage:
    """Prepare a shot for rendering. Raise ``MocapError`` if the motion cannot be read."""
    body, betas = cast(spec, shot.person)
    person = shot.motion.play(body, betas, spec.fps, spec.frames)
    joints = person.landmarks(JointSet.SMPL_24).points
    middle = 0.5 * (joints[:, 0].min(axis=0) + joints[:, 0].max(axis=0))
    if shot.array.stand is not None:
        move = np.array([*(shot.array.stand - middle[:2]), 0.0])
        person, joints, middle = replace(person, transl=person.transl + move), joints + move, middle + move
    cameras, rng = shot.array.around(middle), shot.rng(spec, "scene")
    outfit = draw_outfit(shot.look.clothes, shot.look.hair, rng)
    costume = dress(body, *outfit, rng)
    light = draw_light(shot.look.light, shot.rng(spec, "light"))
    room = furnish(joints[:, 0], cameras, shot.look.furniture, shot.look.room, rng)
    labels = marker_layout(spec.markers) if spec.markers else ()
    markers = person.pose(marker_landmarks(body, labels)).points if labels else np.zeros((len(joints), 0, 3))
    corners = CornerSums(body.faces, len(body.v_template))
    hands = move_hands(person, spec.fps, shot.rng(spec, "hands")) if spec.hands else None
    return Stage(shot, person, cameras, costume, corners, room, outfit, light, labels, markers, joints, hands)


def require_sight(stage: Stage) -> None:
    """Check that a shot can be rendered.

    Raises:
        NobodySeen: no camera sees a joint in any frame.
        CameraInsideBody: a camera is inside the person or closer to the skin than ``CLEARANCE_M``.
    """
    cameras, seen = stage.cameras, False
    near = np.linalg.norm(stage.joints[:, None] - cameras.centres[None, :, None], axis=-1).min(axis=2)
    for view, centre in enumerate(cameras.centres):
        _, px = in_camera(cameras, view, stage.joints.reshape(-1, 3))
        seen = seen or bool(in_pictures(px[None], cameras.image_size[[view]]).any())
        if near[:, view].min() >= 0.6:
            continue
        skin = stage.person.skin(np.argsort(near[:, view], kind="stable")[:_NEAREST])
        off = np.linalg.norm(skin - centre, axis=-1).min()
        if off < CLEARANCE_M or _inside(skin, stage.person.body.faces, centre):
            raise CameraInsideBody(
                f"The camera is {100 * off:.0f} cm from the person's skin, or inside the body.",
                where=f"shot {stage.shot.name}, camera {cameras.names[view]}",
                hint="Move the array away from the person's path, or choose another motion.",
            )
    if not seen:
        raise NobodySeen(
            "No camera sees the person in any frame.",
            where=f"shot {stage.shot.name}",
            hint="Aim the array at the person's path. Rings and corners already do.",
        )


def _inside(skin: np.ndarray, faces: np.ndarray, point: np.ndarray) -> bool:
    """Return whether a point is inside a closed mesh in any of the (n, V, 3) poses.

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
