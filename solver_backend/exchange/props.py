"""Represent the props in a take: rigid bodies that are not part of the person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .errors import MotionInvalid
from .plausible import FARTHEST_M, LARGEST_TURN, require_within
from .schema import Fields
from .so3 import matrix_from_rotvec, rotvec_from_matrix

PROPS = tuple(f"prop_{name}" for name in ("names", "labels", "of", "points", "rotvec", "transl", "sigma", "seen"))
"""Arrays for props in a motion file: names (P,), labels (Q,), the prop that each of the Q points belongs to, and the
fields of ``Prop``, one prop after another."""
POSE_POINTS = ("origin", "x", "y", "z")
"""Suffixes, after the prop's name and a colon, of point labels that represent a recorded pose: origin and axes."""


@dataclass(frozen=True)
class Prop:
    """A rigid body in F frames: ``x_world = R(rotvec) x + transl``, in metres and radians."""

    name: str
    labels: tuple[str, ...]  # (M,) labels of the prop's markers.
    points: np.ndarray  # (M, 3) marker positions relative to the prop, metres.
    rotvec: np.ndarray  # (F, 3) rotation vectors from prop to world.
    transl: np.ndarray  # (F, 3) positions of the origin in the world.
    sigma: np.ndarray
    """(F, 2) standard deviations: of the origin (RMS over the axes, metres), and of the rotation about the least
    certain axis (radians)."""
    seen: np.ndarray
    """(F,) number of visible markers. If it is 0, the pose is interpolated."""

    def __post_init__(self) -> None:
        frames, count = len(self.rotvec), len(self.labels)
        shapes = {"points": (count, 3), "rotvec": (frames, 3), "transl": (frames, 3), "sigma": (frames, 2)}
        for name, shape in {**shapes, "seen": (frames,)}.items():
            value = np.asarray(getattr(self, name))
            if value.shape != shape or not np.isfinite(value).all():
                found = f"{name} of the prop '{self.name}' has shape {value.shape} or values that are not finite"
                raise MotionInvalid(f"{found}, but {shape} is expected.", where="motion")
        for name, most in {"points": FARTHEST_M, "transl": FARTHEST_M, "rotvec": LARGEST_TURN, "seen": 255}.items():
            require_within(f"{name} of the prop '{self.name}'", getattr(self, name), most, MotionInvalid, "motion")
        if (np.asarray(self.seen) < 0).any():
            raise MotionInvalid(f"seen of the prop '{self.name}' contains a negative number.", where="motion")
        object.__setattr__(self, "seen", np.asarray(self.seen).astype(np.uint8))

    @property
    def markers(self) -> np.ndarray:
        """(F, M, 3) marker positions in the world, metres."""
        return self.points @ np.swapaxes(matrix_from_rotvec(self.rotvec), -1, -2) + self.transl[:, None]

    @property
    def is_of_poses(self) -> bool:
        """True if the markers are the origin and axes of a recorded pose instead of recorded markers."""
        return tuple(label.rpartition(":")[2] for label in self.labels) == POSE_POINTS

    def in_axes(self, origin: np.ndarray, axes: np.ndarray) -> Prop:
        """Express the prop in other axes, given their origin (3,) and directions as matrix columns (3, 3)."""
        R = matrix_from_rotvec(self.rotvec)
        points, transl = (self.points - origin) @ axes, self.transl + R @ origin
        return replace(self, points=points, rotvec=rotvec_from_matrix(R @ axes), transl=transl)

    def as_dict(self) -> dict[str, object]:
        """Return the prop as plain JSON values, in metres and radians."""
        markers = {label: point.tolist() for label, point in zip(self.labels, self.points, strict=True)}
        tracks = {name: getattr(self, name).tolist() for name in ("rotvec", "transl", "seen")}
        sigma = dict(zip(("sigma_m", "sigma_rad"), self.sigma.T.tolist(), strict=True))
        return {"name": self.name, "markers": markers, **tracks, **sigma}


def require_length(props: Sequence[Prop], frames: int) -> None:
    """Raise ``MotionInvalid`` unless all props have as many frames as the take."""
    for prop in props:
        if len(prop.rotvec) != frames:
            what = f"The prop '{prop.name}' has {len(prop.rotvec)} frames, but {frames} are expected."
            raise MotionInvalid(what, where="motion")


def prop_arrays(props: Sequence[Prop]) -> dict[str, np.ndarray]:
    """Convert props to arrays for a motion file. Without props, return an empty dictionary."""
    if not props:
        return {}
    stacks = {key: np.stack([getattr(prop, key) for prop in props]) for key in ("rotvec", "transl", "sigma")}
    return {
        "prop_names": np.array([prop.name for prop in props], dtype=np.str_),
        "prop_labels": np.array([label for prop in props for label in prop.labels], dtype=np.str_),
        "prop_of": np.repeat(np.arange(len(props)), [len(prop.labels) for prop in props]),
        "prop_points": np.concatenate([prop.points for prop in props]).astype(np.float32),
        **{f"prop_{key}": stack.astype(np.float32) for key, stack in stacks.items()},
        "prop_seen": np.stack([prop.seen for prop in props]).astype(np.uint8),
    }


def read_props(fields: Fields, frames: int) -> tuple[Prop, ...]:
    """Return the props in a motion file with ``frames`` frames.

    Raises:
        MotionInvalid: the arrays do not match each other or the number of frames.
    """
    names, labels = fields.texts("prop_names"), fields.texts("prop_labels")
    if not names:
        return ()
    missing = [key for key in PROPS if key not in fields]
    if missing:
        raise MotionInvalid(f"The file has props without {', '.join(missing)}.", where=str(fields.path))
    of = fields.shaped("prop_of", (len(labels),), MotionInvalid)
    points = fields.shaped("prop_points", (len(labels), 3), MotionInvalid)
    by_frame = (len(names), frames)
    shapes = {"rotvec": (*by_frame, 3), "transl": (*by_frame, 3), "sigma": (*by_frame, 2), "seen": by_frame}
    tracks = {key: fields.shaped(f"prop_{key}", shape, MotionInvalid) for key, shape in shapes.items()}
    props = []
    for p, name in enumerate(names):
        own = np.flatnonzero(of == p)
        of_prop = {key: track[p] for key, track in tracks.items()}
        props.append(Prop(name, tuple(labels[i] for i in own), points[own], **of_prop))
    return tuple(props)
