"""Add a body's shape sliders, which are shape keys of its mesh."""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.errors import BodyInvalid
from ..conventions.naming import MANNEQUIN, PERSON_LOOK, SEGMENTS_LOOK, SHAVEN_LOOK
from ..conventions.skeleton import NUM_BETAS
from .body_file import BodyFile, once_a_body
from .layout import shape_directions
from .mesh import positions

_UNNAMED = "detail"
_LEAST_SHARE = 0.02
"""Smallest fraction of a measure's variance that a shape direction must explain to get the measure's name."""
_NAMES = {
    "stature": ("stature", "short stature"),
    "build": ("build", "slenderness"),
    "leg": ("leg length", "trunk length"),
    "arm": ("arm length", "short arms"),
    "shoulders": ("shoulder width", "narrow shoulders"),
    "hips": ("hip width", "narrow hips"),
    "head": ("neck and head", "short neck"),
    "thigh": ("thigh length", "shin length"),
    "upper_arm": ("upper arm length", "forearm length"),
    "trunk_depth": ("chest depth", "flat chest"),
    "thigh_girth": ("thigh girth", "slim thighs"),
    "arm_girth": ("arm girth", "slim arms"),
    "foot": ("foot length", "short feet"),
}
"""Names for an increase and for a decrease of each measure."""


@once_a_body
def shape_names(body: BodyFile) -> tuple[str, ...]:
    """Return a name of two or three words for each of the ten shape directions."""
    directions = np.eye(NUM_BETAS)
    changes = [_relative(_measures(body, e), _measures(body, -e)) for e in directions]
    table = np.array([[change[name] for name in _NAMES] for change in changes])
    shares = table**2 / np.maximum((table**2).sum(0), 1e-18)
    names, keys = [_UNNAMED] * NUM_BETAS, list(_NAMES)
    for place in np.argsort(-shares, axis=None, kind="stable").tolist():
        k, m = divmod(place, len(keys))
        if names[k] == _UNNAMED and shares[k, m] > _LEAST_SHARE and not set(_NAMES[keys[m]]) & set(names):
            names[k] = _NAMES[keys[m]][int(table[k, m] < 0)]
    return tuple(names)


def _relative(more: dict[str, float], less: dict[str, float]) -> dict[str, float]:
    """Return each body measure's relative difference between two shapes, or 0 if its mean is 0."""
    both = {name: (more[name] + less[name]) / 2 for name in more}
    return {name: (more[name] - less[name]) / mean if mean > 1e-6 else 0.0 for name, mean in both.items()}


def _measures(body: BodyFile, betas: np.ndarray) -> dict[str, float]:
    vertices, joints = body.shaped(betas), dict(zip(body.layout.joints, body.rest_joints(betas), strict=True))
    stature = float(np.ptp(vertices[:, 1]))
    corners = vertices[body.faces]
    volume = abs(float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))) / 6

    def apart(a: str, b: str) -> float:
        return float(np.linalg.norm(joints[a] - joints[b]))

    thigh, shin = apart("left_hip", "left_knee"), apart("left_knee", "left_ankle")
    upper, forearm = apart("left_shoulder", "left_elbow"), apart("left_elbow", "left_wrist")
    shares = {
        "leg": thigh + shin,
        "arm": upper + forearm,
        "shoulders": apart("left_shoulder", "right_shoulder"),
        "hips": apart("left_hip", "right_hip"),
        "head": apart("neck", "head"),
        "foot": _reach(body, vertices, ("left_ankle", "left_foot"), 2),
        "trunk_depth": _reach(body, vertices, ("spine3",), 2),
        "thigh_girth": _radius(body, vertices, joints, "left_hip", "left_knee"),
        "arm_girth": _radius(body, vertices, joints, "left_shoulder", "left_elbow"),
    }
    found = {name: value / stature for name, value in shares.items()}
    found |= {"stature": stature, "build": volume / stature**2, "thigh": thigh / max(thigh + shin, 1e-9)}
    return found | {"upper_arm": upper / max(upper + forearm, 1e-9)}


def _skin_of(body: BodyFile, vertices: np.ndarray, joints: tuple[str, ...]) -> np.ndarray:
    return vertices[np.isin(body.weights.argmax(axis=1), [body.layout.joints.index(joint) for joint in joints])]


def _reach(body: BodyFile, vertices: np.ndarray, joints: tuple[str, ...], axis: int) -> float:
    skin = _skin_of(body, vertices, joints)
    return float(np.ptp(skin[:, axis])) if len(skin) else 0.0


def _radius(body: BodyFile, vertices: np.ndarray, joints: dict[str, np.ndarray], joint: str, end: str) -> float:
    skin = _skin_of(body, vertices, (joint,)) - joints[joint]
    along = joints[end] - joints[joint]
    length = float(np.linalg.norm(along))
    if not len(skin) or length < 1e-6:
        return 0.0
    return float(np.linalg.norm(np.cross(skin, along / length), axis=1).mean())


_PREFIX = "Shape"
LOOK_KEYS = {
    PERSON_LOOK: "Athletic Wear",
    SHAVEN_LOOK: "Shaven Head",
    MANNEQUIN: "Mannequin",
    SEGMENTS_LOOK: "Segments",
}
"""Name of each look's shape key."""


def _slider_name(index: int, effect: str = "") -> str:
    return f"{_PREFIX} {index} {effect}".rstrip()


def sliders(mesh: bpy.types.Object) -> list[bpy.types.ShapeKey]:
    """Return the ten sliders in the order of the betas. Sliders that were deleted are missing."""
    keys = getattr(mesh.data, "shape_keys", None)
    found: dict[int, bpy.types.ShapeKey] = {}
    for key in keys.key_blocks if keys is not None else ():
        words = key.name.split()
        if len(words) > 1 and words[0] == _PREFIX and words[1].isdecimal():
            found.setdefault(int(words[1]), key)
    return [found[k] for k in range(NUM_BETAS) if k in found]


def effect_of(key: bpy.types.ShapeKey) -> str:
    """Return a slider's effect, such as "Stature", or the slider's full name if the user renamed it."""
    words = key.name.split(maxsplit=2)
    return words[2].capitalize() if len(words) > 2 else key.name


def body_mesh(armature: bpy.types.Object) -> bpy.types.Object | None:
    """Return the skin mesh of a body, or None if it was deleted."""
    keyed = [child for child in armature.children if child.type == "MESH" and child.data.shape_keys]
    return max(keyed, key=lambda mesh: len(sliders(mesh)), default=None)  # clothes may have shape keys too


LARGEST_BETA = 5.0  # Range of the sliders, in standard deviations.


def add_shape_keys(mesh: bpy.types.Object, body: BodyFile, betas: np.ndarray) -> None:
    """Add the basis and ten sliders to a mesh from ``create_mesh``, and set the sliders to a shape."""
    directions, _ = shape_directions(body)
    mesh.shape_key_add(name="Basis", from_mix=False)
    rest = positions(mesh.data.vertices)
    for k, effect in enumerate(shape_names(body)):
        add_key(mesh, _slider_name(k, effect), rest + directions[:, :, k], LARGEST_BETA)
    set_betas(mesh, betas)


def add_key(mesh: bpy.types.Object, name: str, shaped: np.ndarray, limit: float) -> bpy.types.ShapeKey:
    """Add a shape key that, at value 1, moves the vertices to (V, 3) positions in metres."""
    key = mesh.shape_key_add(name=name, from_mix=False)
    key.slider_min, key.slider_max, key.value = -limit, limit, 0.0
    key.points.foreach_set("co", np.ascontiguousarray(shaped, dtype=np.float32).ravel())
    return key


def get_betas(mesh: bpy.types.Object) -> np.ndarray:
    """Return a body's shape (10,), read from its sliders."""
    return np.array([key.value for key in all_sliders(mesh)])


def set_betas(mesh: bpy.types.Object, betas: np.ndarray) -> None:
    """Set a body's sliders to a (10,) shape. Widen their limits if needed."""
    for key, beta in zip(all_sliders(mesh), np.asarray(betas, dtype=np.float64).tolist(), strict=True):
        key.slider_min, key.slider_max = min(key.slider_min, beta), max(key.slider_max, beta)
        key.value = beta


def shaped_vertices(mesh: bpy.types.Object) -> np.ndarray:
    """Return the rest vertices (V, 3) shaped by sliders and looks, in the mesh's space."""
    blocks = mesh.data.shape_keys.key_blocks
    keys = [*sliders(mesh), *(blocks[name] for name in LOOK_KEYS.values() if name in blocks)]
    basis = positions(mesh.data.shape_keys.reference_key.points).astype(np.float64)
    return basis + sum(key.value * (positions(key.points) - basis) for key in keys)


def all_sliders(mesh: bpy.types.Object) -> list[bpy.types.ShapeKey]:
    """Return all ten sliders. Raises ``BodyInvalid`` if the mesh does not have all of them."""
    found = sliders(mesh)
    if len(found) < NUM_BETAS:
        names = f"{_slider_name(0)} to {_slider_name(NUM_BETAS - 1)}"
        raise BodyInvalid(
            f"The object does not have the shape keys {names}.", where=mesh.name, hint="Select the mesh of a body."
        )
    return found
