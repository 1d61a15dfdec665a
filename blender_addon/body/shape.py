"""The ten shape sliders: shape keys of the mesh, whose values also drive the joints (``shape_drivers.py``)."""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.errors import BodyInvalid
from ..conventions.skeleton import NUM_BETAS
from .body_file import BodyFile
from .layout import shape_directions
from .mesh import positions
from .shape_names import shape_names
from .sliders import look_key, slider_name, sliders

LARGEST_BETA = 5.0
"""Sliders reach this many standard deviations either way."""


def add_shape_keys(mesh: bpy.types.Object, body: BodyFile, betas: np.ndarray) -> None:
    """Add the basis and ten sliders to a mesh from ``create_mesh`` and set them to a shape."""
    directions, _ = shape_directions(body)
    mesh.shape_key_add(name="Basis", from_mix=False)
    rest = positions(mesh.data.vertices)
    for k, effect in enumerate(shape_names(body)):
        add_key(mesh, slider_name(k, effect), rest + directions[:, :, k], LARGEST_BETA)
    set_betas(mesh, betas)


def add_key(mesh: bpy.types.Object, name: str, shaped: np.ndarray, limit: float) -> bpy.types.ShapeKey:
    """Add a relative shape key that moves the vertices from rest to these positions at a value of 1.

    Args:
        mesh: a mesh object with a basis.
        name: name of the key.
        shaped: (V, 3) metres.
        limit: values reach from -limit to limit.
    """
    key = mesh.shape_key_add(name=name, from_mix=False)
    key.slider_min, key.slider_max, key.value = -limit, limit, 0.0
    key.points.foreach_set("co", np.ascontiguousarray(shaped, dtype=np.float32).ravel())
    return key


def get_betas(mesh: bpy.types.Object) -> np.ndarray:
    """Return the (10,) shape a body's sliders show.

    Raises:
        BodyInvalid: the object is no body of ours.
    """
    return np.array([key.value for key in all_sliders(mesh)])


def set_betas(mesh: bpy.types.Object, betas: np.ndarray) -> None:
    """Set the sliders; skin and joints follow.

    Args:
        mesh: the body's mesh object.
        betas: (10,) shape; the sliders widen where a value lies beyond their ends.

    Raises:
        BodyInvalid: the object is no body of ours.
    """
    for key, beta in zip(all_sliders(mesh), np.asarray(betas, dtype=np.float64).tolist(), strict=True):
        key.slider_min, key.slider_max = min(key.slider_min, beta), max(key.slider_max, beta)
        key.value = beta


def shaped_vertices(mesh: bpy.types.Object) -> np.ndarray:
    """Return the (V, 3) rest vertices as sliders and look shape them, in the mesh's space."""
    look = look_key(mesh)
    keys = [*sliders(mesh), *([] if look is None else [look])]
    basis = positions(mesh.data.shape_keys.reference_key.points).astype(np.float64)
    return basis + sum(key.value * (positions(key.points) - basis) for key in keys)


def all_sliders(mesh: bpy.types.Object) -> list[bpy.types.ShapeKey]:
    """Return the ten sliders.

    Raises:
        BodyInvalid: the object is no body of ours.
    """
    found = sliders(mesh)
    if len(found) < NUM_BETAS:
        names = f"{slider_name(0)} to {slider_name(NUM_BETAS - 1)}"
        raise BodyInvalid(f"The object lacks the shape keys {names}.", where=mesh.name, hint="Choose a body's mesh.")
    return found
