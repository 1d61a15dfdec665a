"""A curve's keys as arrays, with everything Blender keeps of a key, so that they are copied to the bit."""

from __future__ import annotations

import bpy
import numpy as np

Keys = dict[str, np.ndarray]
"""Each field of the keys of one curve, by its name in Blender."""

_FLOATS = {"co": 2, "handle_left": 2, "handle_right": 2, "back": 1, "amplitude": 1, "period": 1}
"""Numbers a keyframe point has in each of Blender's columns."""
_CHOICES = ("interpolation", "easing", "handle_left_type", "handle_right_type", "type")
_LINEAR = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value


def read_keys(curve: bpy.types.FCurve) -> Keys:
    """Return the keys of a curve: ``co`` and handles (K, 2), everything else (K, 1)."""
    points = curve.keyframe_points
    keys: Keys = {name: np.empty(width * len(points), np.float32) for name, width in _FLOATS.items()}
    keys |= {name: np.empty(len(points), np.int32) for name in _CHOICES}
    for name, values in keys.items():
        points.foreach_get(name, values)
    return {name: values.reshape(len(points), -1) for name, values in keys.items()}


def write_keys(curve: bpy.types.FCurve, keys: Keys) -> None:
    """Replace the keys of a curve."""
    points = curve.keyframe_points
    points.clear()
    points.add(len(keys["co"]))
    for name in (*_CHOICES, *_FLOATS):
        points.foreach_set(name, np.ascontiguousarray(keys[name]).ravel())
    curve.update()


def select_keys(keys: Keys, chosen: np.ndarray) -> Keys:
    """Return some keys, by a (K,) mask."""
    return {name: values[chosen] for name, values in keys.items()}


def join_keys(*parts: Keys) -> Keys:
    """Return keys one after the other."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def times_of(keys: Keys) -> np.ndarray:
    """Return the (K,) scene frames of keys."""
    return keys["co"][:, 0].astype(np.float64)


def linear_keys(times: np.ndarray, values: np.ndarray, like: Keys) -> Keys:
    """Return LINEAR keys.

    Args:
        times: (K,) scene frames.
        values: (K,) values.
        like: keys with at least one, whose other fields they get.
    """
    keys = {name: np.repeat(field[:1], len(times), axis=0) for name, field in like.items()}
    points = np.stack([times, values], axis=1).astype(np.float32).reshape(-1, 2)
    return keys | {
        "co": points, "handle_left": points.copy(), "handle_right": points.copy(),
        "interpolation": np.full((len(times), 1), _LINEAR, np.int32),
    }  # fmt: skip


def make_linear(keys: Keys, index: int) -> None:
    """Let the piece after a key be a straight line."""
    keys["interpolation"][index] = _LINEAR
