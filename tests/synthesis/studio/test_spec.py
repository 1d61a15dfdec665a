"""Descriptions: what is read, and what is refused by name before anything is made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import FileMissing, MocapError, MotionInvalid
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.studio import data_set
from solver_backend.synthesis.studio.camera_arrays import aim_point, build_camera_array, camera_array_presets
from solver_backend.synthesis.studio.checked_values import (
    CameraInsideBody,
    DiskTooSmall,
    NobodySeen,
    OtherDataSet,
    StudioInvalid,
)
from solver_backend.synthesis.studio.data_set import check_data_set, make_data_set, open_data_set, plan
from solver_backend.synthesis.studio.spec import read_spec, spec_of
from solver_backend.synthesis.studio.stage import cast, list_shots, require_sight, set_up
from solver_backend.types import SMPL_JOINTS


def test_shots_are_every_combination_and_seeded_by_their_own_names() -> None:
    values = {"people": {"count": 2}, "camera_arrays": ["oak_d_4", "vicon_12"], "looks": ["suit", "bare"], "seed": 1}
    spec = spec_of(values)
    shots = list_shots(spec)
    assert len(shots) == 8 and len({shot.name for shot in shots}) == 8
    alone = spec_of({**values, "camera_arrays": ["vicon_12"]})
    again = next(s for s in list_shots(alone) if s.name == shots[2].name)
    assert np.array_equal(shots[2].rng(spec, "x").random(4), again.rng(alone, "x").random(4))
    assert not np.array_equal(shots[2].rng(spec, "x").random(4), shots[3].rng(spec, "x").random(4))
    assert np.array_equal(cast(spec, 1)[1], cast(alone, 1)[1])
    assert plan(spec).frames == 8 * 60


@pytest.mark.parametrize("preset", sorted(camera_array_presets()))
def test_presets_see_a_person_whole(preset: str) -> None:
    cameras = build_camera_array(preset).cameras
    for R, t, K, size in zip(cameras.R, cameras.t, cameras.K, cameras.image_size, strict=True):
        for height in (0.1, 1.7):
            u, v, w = K @ (R @ np.array([0.0, 0.0, height]) + t)
            assert w > 0 and 0 < u / w < size[0] and 0 < v / w < size[1]


def test_the_cameras_of_a_capture_stay_where_they_are(tmp_path: Path) -> None:
    capture = demo_capture(8)
    write_capture(tmp_path / "c.npz", capture)
    array = build_camera_array({"layout": "capture", "capture": "c.npz"}, tmp_path)
    assert np.allclose(array.around(np.array([3.0, 1.0, 0.0])).centres, capture.cameras.centres, atol=1e-6)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"cameras": 4}, "Unknown key cameras"),
        ({"version": 9}, "version is 9"),
        ({"camera_arrays": ["optitrack"]}, "no camera array 'optitrack'"),
        ({"camera_arrays": [{"size": [0, 480]}]}, "from 16 to 8192"),
        ({"camera_arrays": [{"count": "four"}]}, "whole number"),
        ({"camera_arrays": [{"layout": "corners", "room_m": [10**400, 5]}]}, "2 numbers"),
        ({"camera_arrays": [{"range_m": [0.3, float("inf")]}]}, "2 numbers"),
        ({"camera_arrays": []}, "at least one"),
        ({"looks": ["armour"]}, "everyday"),
        ({"looks": [{"light": "disco"}]}, "night"),
        ({"film": ["x-ray"]}, "infrared"),
        ({"perturb": "chaos"}, "detector"),
        ({"perturb": {"jitter_mm": -1}}, "jitter_mm"),
        ({"motions": []}, "choreography"),
        ({"frames": 0}, "frames"),
        ({"fps": float("nan")}, "fps"),
        ({"markers": "NOBODY_7"}, "MANIFOLD_53"),
        ({"markers": None, "write": ["c3d"]}, "the person wears none"),
        ({"write": ["video"]}, "colour"),
        ({"write": ["pose2sim"], "camera_arrays": ["oak_d_4", {"count": 1}]}, "ring has one"),
        ({"markers": "CMU_41", "looks": ["everyday"]}, "loose clothes"),
        ({"rgb": {"engine": "unreal"}, "film": ["rgb"]}, "workbench"),
        ([1, 2], "object"),
    ],
)
def test_what_cannot_be_is_refused_and_says_what_can(values: Any, says: str) -> None:
    with pytest.raises(StudioInvalid) as caught:
        spec_of(values)
    assert says in str(caught.value)


def test_an_unknown_key_of_cameras_is_refused_by_name() -> None:
    with pytest.raises(MocapError, match="rigs"):
        spec_of({"rigs": ["oak_d_4"]})


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "spec.json").write_text("{not json")
    with pytest.raises(MocapError, match="not JSON"):
        read_spec(tmp_path / "spec.json")
    with pytest.raises(FileMissing):
        list_shots(spec_of({"motions": ["gone.npz"]}, tmp_path))
    (tmp_path / "motion.npz").write_bytes(b"PK nothing")
    with pytest.raises(MocapError):
        make_data_set(spec_of({"motions": ["motion.npz"]}, tmp_path), tmp_path / "out")


def test_a_motion_of_other_joints_is_refused(tmp_path: Path) -> None:
    rows = "0 0 0 0 0 0\n" * 6
    (tmp_path / "dog.bvh").write_text(
        "HIERARCHY\nROOT Tail\n{\nOFFSET 0 0 0\n"
        "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
        f"End Site\n{{\nOFFSET 0 1 0\n}}\n}}\nMOTION\nFrames: 6\nFrame Time: 0.03\n{rows}"
    )
    with pytest.raises(MotionInvalid):
        open_data_set(spec_of({"motions": ["dog.bvh"]}, tmp_path), tmp_path / "out")
    assert not (tmp_path / "out").exists()


CAMERA = {"K": [[400, 0, 319.5], [0, 400, 239.5], [0, 0, 1]], "image_size": [640, 480]}
AWAY = {**CAMERA, "R": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "t": [0, 1, -9]}
INSIDE = {**CAMERA, "R": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "t": [0, 0.95, 0]}


@pytest.mark.parametrize(("camera", "error"), [(AWAY, NobodySeen), (INSIDE, CameraInsideBody)])
def test_rigs_that_cannot_film_are_refused_before_anything_is_made(
    tmp_path: Path, camera: dict[str, Any], error: type[MocapError]
) -> None:
    spec = spec_of({"camera_arrays": [{"layout": "cameras", "cameras": [camera]}], "frames": 20})
    with pytest.raises(error, match="person"):
        make_data_set(spec, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_camera_that_the_person_walks_through_is_found_in_a_long_motion() -> None:
    """A camera is met for less than a second of six: frames between evenly chosen ones count too."""
    given = {"frames": 180, "fps": 30}
    free = spec_of(given)
    stage = set_up(free, list_shots(free)[0])
    hand = stage.joints[:, SMPL_JOINTS.index("left_wrist")]
    still = np.median(hand, axis=0)
    far = hand[int(np.linalg.norm(hand - still, axis=1).argmax())]
    K, R = [[400, 0, 319.5], [0, 400, 239.5], [0, 0, 1]], np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera = {"K": K, "R": R.tolist(), "t": (-R @ far).tolist(), "image_size": [640, 480]}
    spec = spec_of({**given, "camera_arrays": [{"layout": "cameras", "cameras": [camera]}]})
    with pytest.raises(CameraInsideBody):
        require_sight(set_up(spec, list_shots(spec)[0]))


def test_a_check_writes_nothing_and_says_what_a_rig_with_fewer_cameras_is(tmp_path: Path) -> None:
    small = {
        "film": ["masks"],
        "write": ["exr"],
        "frames": 2,
        "camera_arrays": [{"count": 3, "leave_out": 1, "widest": 320}],
    }
    found = check_data_set(spec_of(small), tmp_path / "out")
    assert found.pictures == 2 * 2 * 2 and not (tmp_path / "out").exists()
    assert found.shots[0].array.cameras.image_size.tolist() == [[320, 240]] * 2
    with pytest.raises(StudioInvalid, match="leaves none"):
        spec_of({"camera_arrays": [{"count": 2, "leave_out": 2}]})
    with pytest.raises(StudioInvalid, match="world, aim"):
        spec_of({"camera_arrays": [{"stand": "anywhere"}]})


def test_a_person_stands_where_fixed_cameras_look() -> None:
    ring = build_camera_array({"count": 3, "radius_m": 2.5}).cameras
    far = ring.centres + [40.0, -7.0, 0.0]
    t = -np.einsum("cij,cj->ci", ring.R, far)
    cameras = [
        {"name": n, "K": K.tolist(), "R": R.tolist(), "t": v.tolist(), "image_size": s.tolist()}
        for n, K, R, v, s in zip(ring.names, ring.K, ring.R, t, ring.image_size, strict=True)
    ]
    array = {"layout": "cameras", "cameras": cameras}
    with pytest.raises(NobodySeen):
        check_data_set(spec_of({"camera_arrays": [array], "frames": 10}), Path("nowhere"))
    spec = spec_of({"camera_arrays": [{**array, "stand": "aim", "scale": 0.5}], "frames": 10})
    stage = set_up(spec, list_shots(spec)[0])
    pelvis = stage.joints[:, 0, :2]
    assert np.allclose(0.5 * (pelvis.min(axis=0) + pelvis.max(axis=0)), [40.0, -7.0], atol=0.05)
    assert np.allclose(stage.cameras.centres, far, atol=1e-9)
    assert np.allclose(stage.cameras.K[:, 0, 2], (320 - 1) / 2)
    alone = aim_point(ring.subset([0]))
    assert np.linalg.norm(alone - ring.centres[0] - 3 * ring.R[0, 2]) < 1e-6, "three metres ahead of a single camera"


def test_a_disk_that_is_too_small_is_told_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = spec_of({"frames": 100_000, "camera_arrays": ["vicon_12"], "people": {"count": 100_000}})
    monkeypatch.setattr(data_set, "list_shots", lambda spec: list_shots(spec_of({"camera_arrays": ["vicon_12"]})) * 100)
    with pytest.raises(DiskTooSmall, match="needs about"):
        open_data_set(spec, tmp_path / "out")


def test_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    small = {"film": [], "frames": 2, "camera_arrays": [{"count": 2}]}
    make_data_set(spec_of(small), tmp_path / "mine")
    with pytest.raises(OtherDataSet, match="another description"):
        make_data_set(spec_of({**small, "seed": 2}), tmp_path / "mine")
    (tmp_path / "holiday").mkdir()
    (tmp_path / "holiday" / "beach.jpg").write_bytes(b"x")
    with pytest.raises(OtherDataSet, match="other files"):
        make_data_set(spec_of(small), tmp_path / "holiday")
    assert json.loads((tmp_path / "mine" / "studio.json").read_text())["description"] == small
