"""Define a frame range of an earlier motion that is solved again, with poses and contacts set by the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.contact_parts import CONTACT_PARTS
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.plausible import FARTHEST_M, LARGEST_TURN, require_within
from solver_backend.types import NUM_JOINTS


@dataclass(frozen=True)
class Pin:
    """Pose that the user set in one frame."""

    frame: int
    """Frame number in the take, from 0."""
    global_orient: np.ndarray
    """(3,) axis-angle rotation of the root."""
    body_pose: np.ndarray
    """(69,) axis-angle rotations of the joints, or (153,) with fingers."""
    transl: np.ndarray
    """(3,) translation in metres."""


@dataclass(frozen=True)
class UserContact:
    """Floor contact that the user added or removed."""

    part: str
    """Name of the body part, a key in ``CONTACT_PARTS``."""
    first: int
    last: int
    touches: bool
    """True if the part touches the floor in these frames, false if it does not."""

    @classmethod
    def from_dict(cls, values: Any, where: str) -> UserContact:
        """Read a contact from a JSON object. Raise ``JobInvalid`` if it is invalid."""
        _check_keys(values, {"part", "first", "last", "touches"}, set(), where)
        if values["part"] not in CONTACT_PARTS:
            hint = f"Known parts: {', '.join(CONTACT_PARTS)}."
            raise JobInvalid(f"There is no body part {values['part']!r}.", where=where, hint=hint)
        if not isinstance(values["touches"], bool):
            raise JobInvalid(f"touches is {values['touches']!r}, but true or false is expected.", where=where)
        return cls(values["part"], _whole(values, "first", where), _whole(values, "last", where), values["touches"])


@dataclass(frozen=True)
class FrameRange:
    """Frames of an earlier motion that are to be solved again."""

    first: int
    """First frame. Its pose does not change unless the take begins here."""
    last: int
    """Last frame. Its pose does not change unless the take ends here."""
    pins: tuple[Pin, ...] = ()
    """Poses that the solution must pass through."""
    contacts: tuple[UserContact, ...] = ()
    """Contacts that the user added or removed. Later entries override earlier ones."""
    forgets: bool = False
    """Ignore contacts from earlier solves of these frames."""

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> FrameRange:
        """Read a frame range from a JSON object.

        Raises:
            JobInvalid: a key is missing or unknown, or a pose has the wrong length or non-finite values.
        """
        _check_keys(values, {"first", "last"}, {"pins", "contacts", "forgets"}, "resolve")
        pins = []
        for number, pin in enumerate(values.get("pins") or ()):
            where = f"resolve, pin {number}"
            _check_keys(pin, {"frame", "global_orient", "body_pose", "transl"}, set(), where)
            given = pin["body_pose"]
            wide = isinstance(given, list) and len(given) == 3 * (SMPL_HANDS.num_joints - 1)
            joints = SMPL_HANDS.num_joints if wide else NUM_JOINTS
            sizes = {"global_orient": 3, "body_pose": 3 * (joints - 1), "transl": 3}
            pins.append(Pin(_whole(pin, "frame", where), **{k: _vector(pin, k, n, where) for k, n in sizes.items()}))
        given = enumerate(values.get("contacts") or ())
        contacts = tuple(UserContact.from_dict(item, f"resolve, contact {number}") for number, item in given)
        if not isinstance(forgets := values.get("forgets", False), bool):
            raise JobInvalid(f"forgets is {forgets!r}, but true or false is expected.", where="resolve")
        ends = _whole(values, "first", "resolve"), _whole(values, "last", "resolve")
        return cls(*ends, tuple(pins), contacts, forgets)

    def as_dict(self) -> dict[str, object]:
        """Return the JSON object that ``from_dict`` reads."""
        names = ("frame", "global_orient", "body_pose", "transl")
        pins = [{name: np.asarray(getattr(pin, name)).tolist() for name in names} for pin in self.pins]
        values: dict[str, object] = {"first": self.first, "last": self.last, "pins": pins}
        values |= {"contacts": list(map(asdict, self.contacts))} if self.contacts else {}
        return values | ({"forgets": True} if self.forgets else {})

    def check(self, num_frames: int) -> None:
        """Raise ``JobInvalid`` unless range, pins and contacts are inside the take."""
        if not 0 <= self.first < self.last < num_frames:
            message = f"Frames {self.first} to {self.last} are not a valid range in this take of {num_frames} frames."
            hint = f"Choose two frames from 0 to {num_frames - 1}, the earlier one first."
            raise JobInvalid(message, where="resolve", hint=hint)
        for pin in self.pins:
            if not self.first <= pin.frame <= self.last:
                message = f"A pose is pinned at frame {pin.frame}, outside frames {self.first} to {self.last}."
                raise JobInvalid(message, where="resolve", hint="Widen the frame range, or remove the pin.")
        for contact in self.contacts:
            if not self.first <= contact.first <= contact.last <= self.last:
                message = f"The contact in frames {contact.first} to {contact.last} is empty or outside the range."
                raise JobInvalid(message, where="resolve", hint="Widen the frame range, or shorten the contact.")


def _check_keys(values: Any, needed: set[str], optional: set[str], where: str) -> None:
    if not isinstance(values, Mapping) or needed - set(values) or set(values) - needed - optional:
        message = f"{where} must contain {', '.join(sorted(needed))} and no other keys."
        raise JobInvalid(message, where=where, hint=f"Known keys: {', '.join(sorted(needed | optional))}.")


def _whole(values: Mapping[str, Any], key: str, where: str) -> int:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int):
        raise JobInvalid(f"{key} is {value!r}, but a whole number is expected.", where=where)
    return value


def _vector(values: Mapping[str, Any], key: str, size: int, where: str) -> np.ndarray:
    try:
        vector = np.asarray(values[key], dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.full(1, np.nan)
    if vector.shape != (size,):
        raise JobInvalid(f"{key} must be {size} numbers.", where=where)
    require_within(key, vector, FARTHEST_M if key == "transl" else LARGEST_TURN, JobInvalid, where)
    return vector
