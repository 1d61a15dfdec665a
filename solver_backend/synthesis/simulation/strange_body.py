"""A body that no shape of the solver's is: bones longer and shorter, flesh elsewhere, as every person has them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body, load_body

_WAVES = 24
"""Random waves that make up the flesh's displacement."""
_WAVELENGTH_M = 0.25
"""Length of a typical one: a calf, a belly."""


@dataclass(frozen=True)
class Strangeness:
    """How far a body is from the solver's."""

    bones: float = 0.04
    """Standard deviation of a bone's length, as a share of it; left and right are alike."""
    flesh_mm: float = 6.0
    """Standard deviation, along each axis, of how far the skin lies elsewhere."""


def strange_body(seed: int, strangeness: Strangeness = Strangeness(), body: Body | None = None) -> Body:
    """Return a body with bones of other lengths and with other flesh.

    Every bone is stretched along itself by its own factor and carries what hangs on it; the skin follows by its
    weights, and is then displaced by a smooth random field. Joints follow from the skin as before, so that the
    keypoints at joints and on the skin lie where the solver's body has none.

    Args:
        seed: decides the body.
        strangeness: how far it is from the given one.
        body: the body to change; the one that ships if left out.
    """
    body, rng = body or load_body(), np.random.default_rng(seed)
    stretched = _stretched(body, strangeness.bones * _alike(body, rng.normal(size=len(body.parents))))
    flesh = 1e-3 * strangeness.flesh_mm * _smooth_field(body.v_template, rng)
    return replace(body, id=f"{body.id}_strange{seed}", v_template=stretched + flesh)


def _alike(body: Body, values: np.ndarray) -> np.ndarray:
    """Return values a joint with those of the right side taken from the left: nearest mirrored rest positions."""
    joints = body.joints_template
    mirrored = joints * [-1.0, 1.0, 1.0]
    twin = np.linalg.norm(joints[:, None] - mirrored[None], axis=-1).argmin(axis=1)
    return values[np.minimum(np.arange(len(joints)), twin)]


def _stretched(body: Body, share: np.ndarray) -> np.ndarray:
    """Return the (V, 3) skin with the bone above each joint longer by a (J,) share of itself."""
    joints, count = body.joints_template, len(body.parents)
    moved, along, strain = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for joint, parent in enumerate(body.parents[1:], start=1):
        bone = joints[joint] - joints[parent]
        moved[joint] = moved[parent] + share[joint] * bone
        along[parent], strain[parent] = bone / np.linalg.norm(bone), share[joint]
    way = np.einsum("vjd,jd->vj", body.v_template[:, None] - joints, along) * strain
    return body.v_template + body.weights @ moved + (body.weights * way) @ along


def _smooth_field(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (N, 3) displacements of unit variance a coordinate at (N, 3) points: a sum of random waves."""
    waves = rng.normal(size=(_WAVES, 3)) * (2 * np.pi / _WAVELENGTH_M / np.sqrt(3.0))
    phases, heights = rng.uniform(0, 2 * np.pi, _WAVES), rng.normal(size=(_WAVES, 3))
    return np.sqrt(2.0 / _WAVES) * np.cos(points @ waves.T + phases) @ heights
