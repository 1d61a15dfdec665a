"""What is seen close up on the committed body: eyes, lips, fingers, wrist, toes, and the skin under a raised arm."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from assets_procedural.detail.eyes import IRIS_M
from assets_procedural.layout import JOINT
from assets_procedural.mesh.charts import EYEBALL, IRIS, LIPS, NAIL, PUPIL
from assets_procedural.quality.contact_sheet import EXTREMES, BakedBody, Degrees, read_baked, rotations
from assets_procedural.skeleton.skinning import pose_skeleton


@pytest.fixture(scope="module")
def body() -> BakedBody:
    return read_baked()


def _edges(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _rims(faces: np.ndarray) -> int:
    """Return how many closed borders a piece of a surface has."""
    keys, counts = np.unique(np.sort(_edges(faces), axis=1), axis=0, return_counts=True)
    _, numbers = np.unique(keys[counts == 1], return_inverse=True)
    pairs = numbers.reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(numbers.max() + 1,) * 2)
    return connected_components(graph, directed=False)[0]


def _left(body: BakedBody, *materials: int) -> np.ndarray:
    shown = np.isin(body.material, materials)
    return body.faces[shown & (body.vertices[body.faces][:, :, 0].min(axis=1) >= 0)]


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def test_irises_are_round_and_look_straight_ahead(body: BakedBody) -> None:
    pupil, iris = _left(body, PUPIL), _left(body, IRIS)
    centre = body.vertices[np.unique(pupil)].mean(axis=0)
    out = np.linalg.norm((body.vertices[np.unique(iris)] - centre)[:, :2], axis=1)
    assert 0.92 * IRIS_M < np.median(out[out > 0.9 * IRIS_M]) < 1.08 * IRIS_M and out.max() < 1.25 * IRIS_M
    gaze = _normals(body.vertices, np.concatenate([pupil, iris])).sum(axis=0)
    assert gaze[2] / np.linalg.norm(gaze) > np.cos(np.deg2rad(6.0))
    assert 0.055 < 2 * centre[0] < 0.070, "the pupils stand apart as in adults"


def test_an_eye_is_open_and_lies_behind_its_lids(body: BakedBody) -> None:
    ball = _left(body, EYEBALL, IRIS, PUPIL)
    assert _rims(ball) == 1
    inside = np.unique(ball)
    keys, counts = np.unique(np.sort(_edges(ball), axis=1), axis=0, return_counts=True)
    rim = np.unique(keys[counts == 1])
    height = np.ptp(body.vertices[rim, 1])
    assert 0.007 < height < 0.013
    beyond = np.setdiff1d(np.unique(body.faces[np.isin(body.faces, rim).any(axis=1)]), inside)
    nearest = np.linalg.norm(body.vertices[beyond][:, None, :2] - body.vertices[rim][None, :, :2], axis=2).argmin(
        axis=1
    )
    assert np.all(body.vertices[beyond, 2] > body.vertices[rim[nearest], 2] + 2e-4), "a lid has a thickness"


def test_lips_are_closed(body: BakedBody) -> None:
    """Lips that part have two borders, the one around them and the one between them."""
    lips = body.faces[body.material == LIPS]
    assert _rims(lips) == 1
    vertices = body.vertices[np.unique(lips)]
    middle = vertices[np.abs(vertices[:, 0]) < 1e-9]
    top, bottom = middle[:, 1].max(), middle[:, 1].min()
    inner = middle[(middle[:, 1] < top - 0.2 * (top - bottom)) & (middle[:, 1] > bottom + 0.2 * (top - bottom))]
    upper, lower = (inner[inner[:, 1] * s > inner[:, 1].mean() * s, 2].max() for s in (1, -1))
    groove = min(upper, lower) - inner[:, 2].min()
    assert 0.0005 < groove < 0.0045, "a groove, not a slit"
    assert np.all(_normals(body.vertices, lips)[:, 2] > 0.0), "no wall of the old slit is left"


def test_no_pocket_is_left_behind_face(body: BakedBody) -> None:
    """Every line of sight from the front meets face and back of the head, and nothing between."""
    faces = body.faces[body.vertices[body.faces][:, :, 1].min(axis=1) > body.joints[JOINT["head"], 1] - 0.02]
    a, b, c = (body.vertices[faces[:, k]] for k in range(3))
    rng = np.random.default_rng(0)
    for x, y in rng.uniform((0.002, 0.0), (0.05, 0.10), (300, 2)) + [0.0, body.joints[JOINT["head"], 1]]:
        areas = [(q[:, 0] - x) * (r[:, 1] - y) - (q[:, 1] - y) * (r[:, 0] - x) for q, r in ((a, b), (b, c), (c, a))]
        hit = np.all(np.array(areas) > 0, axis=0) | np.all(np.array(areas) < 0, axis=0)
        assert np.sum(hit) <= 4, "nostrils and chin at most"


def test_the_back_of_the_wrist_has_no_wart(body: BakedBody) -> None:
    """No two faces around the wrist meet at more than 50 degrees; with the wart it was 57."""
    wrist = body.joints[JOINT["left_wrist"]]
    faces = body.faces[np.linalg.norm(body.vertices[body.faces].mean(axis=1) - wrist, axis=1) < 0.045]
    normal = _normals(body.vertices, faces)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    keys, owner, counts = np.unique(np.sort(_edges(faces), axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(owner.ravel(), kind="stable")
    pairs = np.tile(np.arange(len(faces)), 3)[order[np.isin(owner.ravel()[order], np.nonzero(counts == 2)[0])]]
    cosine = np.einsum("ea,ea->e", normal[pairs[0::2]], normal[pairs[1::2]])
    assert len(keys) > 100 and cosine.min() > np.cos(np.deg2rad(50.0))


def test_skin_under_a_raised_arm_is_no_web(body: BakedBody) -> None:
    """From the waist to the arm the outline widens without a bulge that is broader than the arm above it."""
    pose = rotations(EXTREMES["arms up"])
    posed, plain = body.posed(pose), body.posed(pose, correctives=False)
    shoulder = body.joints[JOINT["left_shoulder"]]

    def breadth(vertices: np.ndarray, low: float, high: float) -> float:
        chosen = vertices[(vertices[:, 1] > shoulder[1] + low) & (vertices[:, 1] < shoulder[1] + high)]
        return float(chosen[:, 0].max())

    arm, bulge = breadth(posed, 0.12, 0.22), breadth(posed, -0.10, 0.10)
    assert bulge < arm + 0.012
    assert breadth(plain, -0.10, 0.10) > bulge + 0.005, "the correctives do it"


_BENT_ARM = {"left_elbow": (0.0, -110.0, 0.0)}


@pytest.mark.parametrize(
    ("pose", "joints", "most"),
    [
        (EXTREMES["arms up"], ("collar", "shoulder"), 0.001),
        (EXTREMES["arms down"], ("collar", "shoulder"), 0.001),
        (_BENT_ARM, ("elbow",), 0.012),
    ],
    ids=["arms up", "arms down", "elbow at 110 degrees"],
)
def test_hardly_any_skin_turns_over(body: BakedBody, pose: Degrees, joints: tuple[str, ...], most: float) -> None:
    """Faces whose normal points against where their bones carry it, in an armpit or an elbow's pit."""
    local = rotations(pose)
    turns, _ = pose_skeleton(body.joints, local)
    pulled = body.weights[:, [JOINT[f"left_{name}"] for name in joints]].sum(axis=1) > 0.15
    faces = body.faces[pulled[body.faces].all(axis=1)]
    blend = (body.weights[faces].mean(axis=1) @ turns.reshape(24, 9)).reshape(-1, 3, 3)
    carried = np.einsum("fab,fb->fa", blend, _normals(body.vertices, faces))
    share = np.mean(np.einsum("fa,fa->f", carried, _normals(body.posed(local), faces)) < 0)
    assert share <= most


def test_fingers_curl_more_towards_the_little_one(body: BakedBody) -> None:
    """Fingertips hang below the back of the hand, those of the outer fingers nearer to the wrist."""
    hand = body.vertices[body.weights[:, JOINT["left_hand"]] > 0.9] - body.joints[JOINT["left_hand"]]
    tips = [hand[(np.abs(hand[:, 2] - z) < 0.008)][:, 0].max() for z in (0.027, 0.005, -0.015, -0.034)]
    assert tips[1] > tips[2] > tips[3] and tips[0] > tips[3]
    assert -0.075 < hand[:, 1].min() < -0.035
    width = np.ptp(hand[hand[:, 0] > 0.03][:, 2])
    assert width < 0.085, "not splayed"


def test_five_toes_stand_apart(body: BakedBody) -> None:
    """Along the tips of the toes the outline has four furrows."""
    foot = body.vertices - body.joints[JOINT["left_foot"]]
    ahead = foot[(body.vertices[:, 0] > 0) & (body.weights[:, JOINT["left_foot"]] > 0.5) & (foot[:, 1] > -0.018)]
    across = np.arange(-0.018, 0.052, 0.002)
    outline = np.array([ahead[np.abs(ahead[:, 0] - x) < 0.003][:, 2].max() for x in across])
    straight = np.interp(across, across[[0, -1]], outline[[0, -1]])
    bow = np.polynomial.Polynomial.fit(across, outline - straight, 4)(across)
    signs = np.sign(outline - straight - bow)
    assert np.sum(signs[1:] * signs[:-1] < 0) >= 5


def test_ten_fingers_and_two_big_toes_have_nails(body: BakedBody) -> None:
    """Each is one piece of a nail's size, bulges outwards, and lies on the back of a finger or on a toe."""
    nails = body.faces[body.material == NAIL]
    pairs = _edges(nails)
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(body.vertices),) * 2)
    label = connected_components(graph, directed=False)[1][nails[:, 0]]
    assert len(np.unique(label)) == 12
    for number in np.unique(label):
        faces = nails[label == number]
        area = 1e6 * 0.5 * np.linalg.norm(_normals(body.vertices, faces), axis=1).sum()
        middle, normal = body.vertices[np.unique(faces)].mean(axis=0), _normals(body.vertices, faces).sum(axis=0)
        assert 35.0 < area < 160.0, "mm²"
        side, sign = ("left", 1.0) if middle[0] > 0 else ("right", -1.0)
        out = (sign * normal[0] + normal[1]) / np.linalg.norm(normal)
        assert out > 0.3, "backs of curled fingers look up or outwards, palms and soles down or inwards"
        joint = body.joints[JOINT[f"{side}_{'hand' if middle[1] > 0 else 'foot'}"]]
        assert 0.03 < np.linalg.norm(middle - joint) < 0.11
        border = np.unique(body.faces[np.isin(body.faces, faces).any(axis=1) & (body.material != NAIL)])
        fold = body.vertices[np.setdiff1d(border, faces)].mean(axis=0)
        assert (middle - fold) @ normal > 0, "the plate stands over the fold"
