"""Build the body file from the committed numbers."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from assets_procedural.detail.fingers import finger_knots, relax_fingers
from assets_procedural.detail.lay_on import blank_face, lay_on_details
from assets_procedural.hand.joints import Knots
from assets_procedural.layout import BORDERS, JOINT, PARENTS
from assets_procedural.mesh.charts import MATERIAL_NAMES, PART_FACING, build_texture_map, face_materials, face_parts
from assets_procedural.mesh.meshing import SymmetricMesh, build_mesh
from assets_procedural.population.shape import build_shape_space
from assets_procedural.population.statistics import load_statistics
from assets_procedural.primitives import load_primitives
from assets_procedural.skeleton.correctives import fit_correctives
from assets_procedural.skeleton.skinning import fit_regressor, heat_weights, load_joints
from solver_backend.exchange.outputs import atomic_output

BODY_FILE = Path(__file__).parents[1] / "solver_backend" / "assets" / "body_neutral.npz"
BODY_ID = "manifold_neutral"
NUM_VERTICES = 7200  # Number of vertices of the body (SMPL has 6,890). Chosen by hand.
_LOG = logging.getLogger(__name__)
# In SMPL's files, the parent of the root is -1, stored as an unsigned 32-bit number.
KINTREE = np.array([[4294967295, *PARENTS[1:]], range(len(PARENTS))], dtype=np.uint32)
_T = TypeVar("_T")


@dataclass(frozen=True)
class BuiltBody:
    """Arrays of the body file, and the finger knots that its hands are built from."""

    arrays: dict[str, np.ndarray]  # Arrays of the body file, by key.
    knots: Knots  # Knots of the body's digits. The pelvis is the origin.


def build_body(num_vertices: int = NUM_VERTICES, fitted: SymmetricMesh | None = None) -> BuiltBody:
    """Return the arrays of the body file. In every shape, the pelvis is the origin.

    SMPL's keys are ``v_template, shapedirs, posedirs, J_regressor, weights, kintree_table, f``. Additional keys are:

    - ``body_id``, ``mirror`` (V,)
    - ``vt`` (T, 2) and ``ft`` (F, 3) with seams, ``face_material`` (F,) and ``material_names``
    - ``J`` (24, 3) and ``J_shapedirs`` (24, 3, 10), the joints that the regressor was fitted to
    - ``blank_vertices`` (N,) and ``blank_offsets`` (N, 3) in metres, which remove the face

    Args:
        num_vertices: number of vertices of a new skin mesh, used if ``fitted`` is None.
        fitted: existing skin mesh, or None to create one.
    """
    statistics, fitted_joints = load_statistics(), load_joints()
    skin = fitted or _timed("mesh", lambda: build_mesh(load_primitives(), num_vertices, BORDERS))
    detailed = _timed("details", lambda: lay_on_details(skin, fitted_joints))
    mesh, part = detailed.mesh, face_parts(detailed.mesh.vertices, detailed.mesh.faces)
    carried = np.concatenate([mesh.vertices, finger_knots(fitted_joints)])
    space = _timed("shape", lambda: build_shape_space(skin.vertices, skin.faces, fitted_joints, statistics, carried))
    origin, count = space.joints[0], len(mesh.vertices)
    spread, joints = space.carried - origin, space.joints - origin

    def relaxed(points: np.ndarray) -> np.ndarray:
        return relax_fingers(points[:count], points[count:], mesh.vertices, fitted_joints)

    vertices = _rounded(relaxed(spread[..., None])[..., 0])
    vertex_dirs = _rounded(relaxed(space.carried_dirs))
    weights = _timed("weights", lambda: heat_weights(_rounded(spread[:count]), mesh.faces, mesh.mirror, joints))
    weights = weights.astype(np.float32).astype(np.float64)
    regressor = _timed("regressor", lambda: fit_regressor(vertices, vertex_dirs, joints, space.joint_dirs, mesh.mirror))
    posedirs = _timed("correctives", lambda: fit_correctives(vertices, mesh.faces, weights, joints, mesh.mirror))
    blank, offsets = blank_face(vertices, mesh.faces, joints[JOINT["head"]])
    texture = _timed("texture", lambda: build_texture_map(space.carried[:count], mesh.faces, part, PART_FACING))
    real = {"v_template": vertices, "shapedirs": vertex_dirs, "J": joints, "J_shapedirs": space.joint_dirs}
    real |= {"J_regressor": regressor, "weights": weights, "vt": texture.vt, "blank_offsets": _rounded(offsets)}
    whole = {"f": mesh.faces, "ft": texture.ft, "mirror": mesh.mirror, "blank_vertices": blank}
    arrays = {"body_id": np.array(BODY_ID), "kintree_table": KINTREE, "posedirs": posedirs.astype(np.float16)}
    arrays |= {"face_material": face_materials(part, detailed.feature), "material_names": np.array(MATERIAL_NAMES)}
    arrays |= {key: values.astype(np.float32) for key, values in real.items()}
    arrays |= {key: values.astype(np.uint32) for key, values in whole.items()}
    return BuiltBody(arrays, Knots.relaxed(spread[count:], space.carried_dirs[count:]))


def write_body(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write the arrays to a file without pickle. After a failure, the old file is unchanged."""
    with atomic_output(path, overwrite=True) as temporary:
        np.savez_compressed(temporary, **arrays)


def _rounded(values: np.ndarray) -> np.ndarray:
    """Round values to 0.1 micrometre. This hides differences in the last bits between machines."""
    return np.round(values, 7).astype(np.float32).astype(np.float64)


def _timed(name: str, work: Callable[[], _T]) -> _T:
    start = time.perf_counter()
    result = work()
    _LOG.info("%s: %.1f s", name, time.perf_counter() - start)
    return result
