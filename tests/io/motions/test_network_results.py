"""Results of networks are read as their public code lays them out, and nothing in them is run."""

from __future__ import annotations

import pickle
import warnings
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import FileDamaged, MocapError, MotionInvalid, NonFiniteData, UnsafePickle
from solver_backend.fitters.motion_import.network_motion import network_motion, without_gaps
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.network_results import is_network_result, read_network_result
from solver_backend.io.packed_values import read_packed
from solver_backend.types.network_result import NetworkResult
from tests.support.network_files import PROGRAMS, ROTATIONS, Z_UP_TO_Y_UP, FilmedMotion, write_network_file

FRAMES = 6
_TO_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # From Z up to a camera's Y down.


@pytest.fixture(scope="module")
def filmed() -> FilmedMotion:
    rng = np.random.default_rng(4)
    steps = np.linspace(0.0, 0.2, FRAMES)[:, None, None]
    local = np.asarray(exp_so3(0.3 * rng.standard_normal((1, 21, 3)) + steps * rng.standard_normal((1, 21, 3))))
    body_to_world = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    turned = np.asarray(exp_so3(np.linspace(0.0, 0.5, FRAMES)[:, None] * np.array([0.0, 0.0, 1.0]))) @ body_to_world
    world_to_camera = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    transl = np.linspace([0.0, 0.0, 1.2], [0.4, 0.3, 1.2], FRAMES)
    fingers = 0.3 * rng.standard_normal((FRAMES, 30, 3)).astype(np.float32)
    body = load_body()
    return FilmedMotion(body, turned, local, transl, world_to_camera, np.array([0.0, 1.0, 4.0]), fingers)


@pytest.mark.parametrize("program", PROGRAMS)
def test_each_program_is_read_in_the_cameras_axes(program: str, filmed: FilmedMotion, tmp_path: Path) -> None:
    path = write_network_file(program, filmed, tmp_path)
    assert is_network_result(path)
    (person,) = read_network_result(path)
    assert np.array_equal(person.frames, np.arange(FRAMES))
    if program in ROTATIONS:
        assert person.program == program and person.local is not None
        assert np.abs(person.local[:, 1:] - filmed.local).max() < 1e-5
        assert np.abs(person.local[:, 0] - filmed.R @ filmed.root).max() < 1e-5
        if person.world is not None:
            assert np.abs(person.world - filmed.root).max() < 1e-5
        if program in ("GEM-X", "PromptHMR"):
            assert np.abs(person.fingers - exp_so3(filmed.fingers)).max() < 1e-5
    else:
        assert person.points is not None
        knee, ankle = (person.points[:, person.names.index(f"left_{part}")] for part in ("knee", "ankle"))
        from solver_backend.exchange.joint_sets import JointSet

        there, names = filmed.points(JointSet.H36M_17), JointSet.H36M_17.keypoints
        bone = there[:, names.index("left_ankle")] - there[:, names.index("left_knee")]
        cosine = ((ankle - knee) * bone).sum(-1) / np.linalg.norm(ankle - knee, axis=-1) / np.linalg.norm(bone, axis=-1)
        assert cosine.min() > 0.99


def test_rotations_become_a_motion_with_fingers_on_the_floor(filmed: FilmedMotion, tmp_path: Path) -> None:
    people = read_network_result(write_network_file("PromptHMR", filmed, tmp_path))
    motion, found = network_motion(people, filmed.body, fps=25.0)
    assert motion.fps == 25.0 and motion.body_layout.num_joints > 24
    assert np.ptp(motion.transl - filmed.transl, axis=0).max() < 1e-4
    assert {item.code for item in found} == {"other_body_read"}


def test_gaps_are_interpolated_and_reported(filmed: FilmedMotion, tmp_path: Path) -> None:
    (person,) = read_network_result(write_network_file("WHAM", filmed, tmp_path))
    cut = person.of_frames(np.array([0, 1, 3, 4, 5]))
    whole = without_gaps(cut)
    assert len(whole.frames) == FRAMES and np.abs(whole.local[2] - person.local[2]).max() < 0.01
    _, found = network_motion((cut,), filmed.body)
    assert {"frames_unseen", "frame_rate_assumed"} <= {item.code for item in found}


def test_two_people_are_named_and_one_is_chosen(filmed: FilmedMotion, tmp_path: Path) -> None:
    (person,) = read_network_result(write_network_file("WHAM", filmed, tmp_path))
    other = NetworkResult("WHAM", "7", person.frames[:3], person.local[:3], None, person.world[:3], person.transl[:3])
    motion, found = network_motion((person, other), filmed.body, person="7")
    assert motion.num_frames == 3 and "people_left_out" in {item.code for item in found}
    with pytest.raises(MotionInvalid, match="no person '9'.*1, 7"):
        network_motion((person, other), filmed.body, person="9")


class _Runs:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("ran",)


def test_nothing_in_a_file_is_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wham_output.pkl"
    path.write_bytes(pickle.dumps({0: {"pose": _Runs()}}))
    with pytest.raises(UnsafePickle, match=r"asks for builtins\.print"):
        read_network_result(path)
    assert "ran" not in capsys.readouterr().out


@pytest.mark.parametrize("program", ["GVHMR", "WHAM", "4D-Humans", "TRAM", "SAM 3D Body"])
def test_a_cut_file_is_a_named_error(program: str, filmed: FilmedMotion, tmp_path: Path) -> None:
    path = write_network_file(program, filmed, tmp_path)
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(MocapError):
        read_network_result(path)


def test_a_pickle_of_something_else_names_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "model.pkl"
    path.write_bytes(pickle.dumps({"weights": [1.0], "epoch": 3}))
    with pytest.raises(FileDamaged, match="It contains weights, epoch"):
        read_network_result(path)


def test_older_files_of_pytorch_and_its_number_types_are_read(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from solver_backend.io.packed_values import numbers

    x = torch.arange(12.0).reshape(3, 4)
    content = {"x": x.T, "half": x.half(), "brain": x.bfloat16(), "whole": torch.arange(3)}
    for name, zipped in (("new.pt", True), ("old.pt", False)):
        torch.save(content, tmp_path / name, _use_new_zipfile_serialization=zipped)
        read = read_packed(tmp_path / name)
        for key, value in content.items():
            assert np.array_equal(numbers(read[key]), value.float().numpy())


def _points(frames: int = 3) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((frames, 70, 3))


def _turns(count: int = 3) -> dict[str, np.ndarray]:
    pose, trans = np.zeros((count, 72)), np.zeros((count, 3))
    return {"pose": pose, "trans": trans, "pose_world": pose, "trans_world": trans, "frame_ids": np.arange(count)}


def _written(content: object, path: Path) -> Path:
    path.write_bytes(pickle.dumps(content))
    return path


def test_plain_pickles_of_nested_arrays_are_read(tmp_path: Path) -> None:
    (person,) = read_network_result(_written({0: _turns()}, tmp_path / "wham.pkl"))
    assert person.program == "WHAM" and person.local.shape == (3, 22, 3, 3)
    incam = {"global_orient": np.zeros((3, 3)), "body_pose": np.zeros((3, 63)), "transl": np.zeros((3, 3))}
    content = {"smpl_params_incam": incam, "smpl_params_global": incam}
    (person,) = read_network_result(_written(content, tmp_path / "gvhmr.pkl"))
    assert person.program == "GVHMR" and len(person.frames) == 3
    listed = [[{"pred_keypoints_3d": one}] for one in _points()]
    (person,) = read_network_result(_written(listed, tmp_path / "sam.pkl"))
    assert person.program == "SAM 3D Body" and len(person.frames) == 3
    np.save(tmp_path / "sam.npy", {"pred_keypoints_3d": _points()}, allow_pickle=True)
    assert len(read_network_result(tmp_path / "sam.npy")[0].frames) == 3


@pytest.mark.parametrize(("axis", "R"), [("Y", Z_UP_TO_Y_UP), ("Z", np.eye(3)), ("-Y", _TO_CAMERA)])
def test_pickled_smpl_motions_stand_along_their_own_axis(axis, R, filmed: FilmedMotion, tmp_path: Path) -> None:
    """AIST++ writes lengths times a scale, smplx takes the pelvis apart, and joblib's people are numbered."""
    root, body = filmed.roots(R), filmed.vectors.reshape(FRAMES, 63)
    poses = np.hstack([root, body, np.zeros((FRAMES, 6))])
    aist = {
        "smpl_loss": 1.5,
        "smpl_poses": poses,
        "smpl_scaling": np.array([94.0]),
        "smpl_trans": 94 * filmed.transl @ R.T,
    }
    smplx = {"global_orient": root, "body_pose": body, "transl": filmed.transl @ R.T, "fps": 60.0}
    for content in (aist, {3: smplx}):
        (person,) = read_network_result(_written(content, tmp_path / "motion.pkl"))
        assert person.program == f"SMPL, {axis} up" and person.fps == (None if content is aist else 60.0)
        assert (
            np.abs(person.world - filmed.root).max() < 1e-5 and np.abs(person.local[:, 1:] - filmed.local).max() < 1e-5
        )
        assert np.abs(person.transl - filmed.transl).max() < 1e-5


def test_fingers_and_the_rate_of_a_pickled_smpl_motion_are_read(filmed: FilmedMotion, tmp_path: Path) -> None:
    root, body = filmed.roots(Z_UP_TO_Y_UP), filmed.vectors.reshape(FRAMES, 63)
    smplx = {"global_orient": root, "body_pose": body, "transl": filmed.transl, "mocap_frame_rate": np.array([60])}
    smplx |= {"left_hand_pose": np.full((FRAMES, 45), 0.1), "right_hand_pose": np.zeros((FRAMES, 45))}
    (person,) = read_network_result(_written(smplx, tmp_path / "smplx.pkl"))
    assert person.fps == 60 and person.fingers is not None
    assert np.abs(person.fingers[:, :15] - exp_so3(np.full(3, 0.1))).max() < 1e-6
    lying = smplx | {"global_orient": np.tile([0.25 * np.pi, 0.0, 0.0], (FRAMES, 1))}
    with pytest.raises(FileDamaged, match="up axis is unknown"):
        read_network_result(_written(lying, tmp_path / "bent.pkl"))


def test_shared_lists_do_not_expand(tmp_path: Path) -> None:
    shared: object = [0.0]
    for _ in range(40):
        shared = [shared, shared]
    with pytest.raises(FileDamaged, match="expand to more than"):
        read_packed(_written({"pred_keypoints_3d": shared}, tmp_path / "shared.pkl"))
    own: list[object] = []
    own += [own, own]
    with pytest.raises(FileDamaged, match="nested too deeply"):
        read_packed(_written(own, tmp_path / "own.pkl"))


@pytest.mark.parametrize(
    "frames", [[0.0, 1.0, np.nan], [0, 1, 2**45], [-1, 0, 1], [[0], [1], [2]], [0, 1, 2_000_000], [2**40] * 3]
)
def test_impossible_frame_numbers_are_refused(frames: list[float], tmp_path: Path) -> None:
    np.savez(tmp_path / "sam.npz", joints_3d=_points(), frame_idx=np.array(frames))
    with pytest.raises(MotionInvalid, match="frame"):
        read_network_result(tmp_path / "sam.npz")
    with pytest.raises(MotionInvalid, match="frame"):
        read_network_result(_written({0: {**_turns(), "frame_ids": np.array(frames)}}, tmp_path / "wham.pkl"))


def test_complex_points_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "sam.npz", joints_3d=_points() + 1j)
    with pytest.raises(FileDamaged, match="numbers are expected"):
        read_network_result(tmp_path / "sam.npz")


def test_mirrored_and_sheared_matrices_are_refused(tmp_path: Path) -> None:
    for wrong in (-np.eye(3), np.diag([2.0, 0.5, 1.0])):
        person = _turns()
        person["pose_world"] = np.tile(wrong, (3, 24, 1, 1))
        with pytest.raises(MotionInvalid, match="'world' are not rotations"):
            read_network_result(_written({0: person}, tmp_path / "wham.pkl"))


def test_json_without_frames_is_a_named_error(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    path.write_text('{"world_landmarks": 1}')
    with pytest.raises(FileDamaged, match="unexpected layout"):
        read_network_result(path)


def test_files_of_pytorch_expand_only_by_their_strides(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from solver_backend.io.packed_values import numbers

    torch.save({"x": torch.ones(1).expand(4)}, tmp_path / "one.pt")
    assert np.array_equal(numbers(read_packed(tmp_path / "one.pt")["x"]), np.ones(4))
    with zipfile.ZipFile(tmp_path / "one.pt") as stored, zipfile.ZipFile(tmp_path / "bomb.pt", "w") as bomb:
        for entry in stored.infolist():
            bomb.writestr(entry.filename, stored.read(entry), zipfile.ZIP_BZIP2)
    with pytest.raises(FileDamaged, match="are compressed"):
        read_packed(tmp_path / "bomb.pt")


def test_a_storage_that_is_loaded_again_and_again_is_refused(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    inner = BytesIO()
    torch.save(torch.zeros(1 << 20)._typed_storage(), inner, _use_new_zipfile_serialization=False)
    data = inner.getvalue()
    start = b"\x80\x03]B" + len(data).to_bytes(4, "little") + data + b"q\x000ctorch.storage\n_load_from_bytes\nq\x010"
    path = tmp_path / "again.pkl"
    path.write_bytes(start + b"h\x01h\x00\x85Ra" * 30 + b".")
    with pytest.raises(FileDamaged, match="far more memory than the file size allows"):
        read_packed(path)


def test_a_nan_of_any_kind_is_read_without_a_warning(filmed: FilmedMotion, tmp_path: Path) -> None:
    path = write_network_file("MotionBERT", filmed, tmp_path)
    points = np.load(path)
    points.view(np.uint32)[0, 0, 0] = 0x7F800001  # a signalling NaN
    np.save(path, points)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (person,) = read_network_result(path)
    assert person.points is not None and np.isnan(person.points[0]).any()


def _walked(frames: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Return joints (F, 22, 3), Y up, of a body that turns and walks, and HumanML3D's vectors of them."""
    rng = np.random.default_rng(5)
    heading, ground = np.cumsum(rng.normal(0.1, 0.2, frames)), np.cumsum(rng.normal(0.0, 0.05, (frames, 2)), axis=0)
    heading, ground = heading - heading[0], ground - ground[0]
    facing = Rotation.from_rotvec(-heading[:, None] * [0.0, 1.0, 0.0])  # from the root's axes to the world
    inner = rng.normal(0.0, 0.4, (frames, 22, 3))
    inner[:, 0, [0, 2]] = 0.0
    place = np.stack([ground[:, 0], np.zeros(frames), ground[:, 1]], axis=1)
    joints = np.stack([place[f] + facing[f].apply(inner[f]) for f in range(frames)])
    vectors = np.zeros((frames, 263))
    vectors[:-1, 0] = np.diff(heading) / 2.0
    vectors[:-1, [1, 2]] = facing[1:].inv().apply(np.diff(place, axis=0))[:, [0, 2]]
    vectors[:, 3], vectors[:, 4:67] = inner[:, 0, 1], inner[:, 1:].reshape(frames, -1)
    return joints, vectors


def test_vectors_and_joints_of_humanml3d_are_the_same_motion(tmp_path: Path) -> None:
    joints, vectors = _walked()
    read = []
    for name, array in (("vectors", vectors), ("joints", joints.astype(np.float32))):
        np.save(tmp_path / f"{name}.npy", array)
        assert is_network_result(tmp_path / f"{name}.npy")
        (person,) = read_network_result(tmp_path / f"{name}.npy")
        assert person.program == "HumanML3D" and person.fps == 20.0 and person.names[7] == "left_ankle"
        read.append(person.points)
    assert np.abs(read[0] - joints * [1.0, -1.0, -1.0]).max() < 1e-9 and np.abs(read[0] - read[1]).max() < 1e-6


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_vectors_with_a_number_that_is_none_are_refused(wrong: float, tmp_path: Path) -> None:
    """The root's place is a sum, so that one such number takes all frames after it."""
    _, vectors = _walked()
    vectors[3, 1] = wrong
    np.save(tmp_path / "vectors.npy", vectors)
    with pytest.raises(NonFiniteData, match="NaN or infinite") as found:
        read_network_result(tmp_path / "vectors.npy")
    assert "frame 3" in found.value.where
    np.save(tmp_path / "vectors.npy", vectors[:0])
    with pytest.raises(MotionInvalid, match="no frames"):
        read_network_result(tmp_path / "vectors.npy")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("length", [0.0, -5.0, np.nan])
def test_an_impossible_length_of_a_sample_is_named(length: float, tmp_path: Path) -> None:
    motion = np.stack(2 * [_walked()[0]]).transpose(0, 2, 3, 1)
    held = {"motion": motion, "lengths": np.array([12.0, length])}
    np.save(tmp_path / "results.npy", np.array(held, object), allow_pickle=True)
    with pytest.raises(MotionInvalid, match="Sample 1"):
        read_network_result(tmp_path / "results.npy")


def test_samples_of_mdm_have_their_own_lengths(tmp_path: Path) -> None:
    joints, _ = _walked()
    motion = np.stack([joints, joints[::-1]]).transpose(0, 2, 3, 1)
    held = {"motion": motion, "text": ["a person walks", "back"], "lengths": np.array([7, 12]), "num_samples": 2}
    np.save(tmp_path / "results.npy", np.array(held, object), allow_pickle=True)
    longest, other = read_network_result(tmp_path / "results.npy")
    assert (longest.person, len(longest.frames), other.person, len(other.frames)) == ("1", 12, "0", 7)
    assert longest.program == "MDM" and np.abs(other.points - joints[:7] * [1.0, -1.0, -1.0]).max() < 1e-12
    assert other.fps == 20.0


@pytest.mark.slow
def test_a_real_result_of_mdm_is_read(shared_data: Path) -> None:
    (person,) = read_network_result(shared_data / "cases" / "motions4" / "mdm_npy" / "results.npy")
    assert person.points is not None and person.points.shape == (5, 22, 3)
    assert (person.points[:, 15, 1] < person.points[:, 0, 1]).all(), "the head is above the pelvis, Y down"
    motion, found = network_motion((person,), load_body())
    assert motion.fps == 20.0 and "frame_rate_assumed" not in {item.code for item in found}
