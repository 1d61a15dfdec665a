"""Own keypoint names by ``keypoints.json``, SLEAP's HDF5, and formats that are named with how to convert them."""

from __future__ import annotations

import csv
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import BackendMissing, CaptureNotRecognised, FileDamaged, KeypointCountMismatch
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, JointSet
from tests.support.calibration_files import toml_text
from tests.support.words import words

FRAMES = 30
OWN = {
    "kneeR_in": "right_knee", "kneeR_out": "right_knee", "kneeL_in": "left_knee", "kneeL_out": "left_knee",
    "footR": "right_ankle", "footL": "left_ankle", "toeR": "right_big_toe", "toeL": "left_big_toe",
    "hueftR": "right_hip", "hueftL": "left_hip", "schulterR": "right_shoulder", "schulterL": "left_shoulder",
    "handR": "right_wrist", "handL": "left_wrist", "armR": "right_elbow", "armL": "left_elbow",
}  # fmt: skip
"""Sixteen points of somebody's own, two a knee, and a seventeenth that means nothing."""
NAMES = (*OWN, "tail")


@pytest.fixture(scope="module")
def demo() -> Capture:
    return demo_capture(FRAMES)


def own_points(demo: Capture, camera: int) -> np.ndarray:
    """Return (F, 17, 3) what a detector of these points finds: either side of a knee, 8 px from its middle."""
    _, keypoints = demo.require_multiview()
    names = keypoints.joint_set.keypoints
    columns = [names.index(meant) for meant in OWN.values()]
    xy, confidence = keypoints.xy[camera][:, columns], keypoints.confidence[camera][:, columns]
    aside = np.array([{"_in": -8.0, "out": 8.0}.get(name[-3:], 0.0) for name in OWN])
    points = np.concatenate([xy + np.stack([aside, 0 * aside], -1), confidence[..., None]], axis=-1)
    return np.concatenate([points, np.tile([100.0, 50.0, 0.9], (len(points), 1, 1))], axis=1)


def with_calibration(root: Path, demo: Capture) -> Path:
    (root / "calibration").mkdir(parents=True)
    (root / "calibration" / "Calib.toml").write_text(toml_text(demo.require_multiview()[0]))
    return root


def write_dlc(root: Path, demo: Capture) -> Path:
    for c, camera in enumerate(demo.require_multiview()[0].names):
        with (root / f"{camera}DLC_resnet50_dance.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["scorer", *["me"] * 3 * len(NAMES)])
            table.writerow(["bodyparts", *[name for name in NAMES for _ in range(3)]])
            table.writerow(["coords", *["x", "y", "likelihood"] * len(NAMES)])
            for f, points in enumerate(np.nan_to_num(own_points(demo, c))):
                table.writerow([f, *points.ravel().tolist()])
    return root


def knee_error_px(capture: Capture, demo: Capture) -> float:
    one, other = capture.require_multiview()[1], demo.require_multiview()[1]
    columns = [k.joint_set.keypoints.index("right_knee") for k in (one, other)]
    return float(np.nanmedian(np.abs(one.xy[:, :, columns[0]] - other.xy[:, :, columns[1]])))


def test_own_names_solve_as_landmarks(tmp_path, demo):
    root = write_dlc(with_calibration(tmp_path / "take", demo), demo)
    with pytest.raises(KeypointCountMismatch, match=r"keypoints\.json file next to the recording"):
        load_capture(root, fps=60.0)
    (root / "keypoints.json").write_text(json.dumps({"landmarks": {**OWN, "tail": None}}))
    capture = load_capture(root, fps=60.0)
    assert knee_error_px(capture, demo) < 0.1, "two points that mean one knee are its middle"
    assert any("keypoints.json" in note for note in words(capture.notes))
    names = capture.require_multiview()[1].joint_set.keypoints
    assert {"right_big_toe", "left_wrist"} <= set(names)


def test_columns_without_names_are_named_by_their_order(tmp_path, demo):
    root = with_calibration(tmp_path / "take", demo)
    for c, camera in enumerate(demo.require_multiview()[0].names):
        folder = root / "pose" / f"{camera}_json"
        folder.mkdir(parents=True)
        for f, points in enumerate(np.nan_to_num(own_points(demo, c))):
            people = [{"pose_keypoints_2d": points.ravel().tolist()}]
            (folder / f"{camera}_{f:06d}_keypoints.json").write_text(json.dumps({"people": people}))
    (root / "keypoints.json").write_text(json.dumps({"order": list(NAMES), "landmarks": {**OWN, "tail": None}}))
    assert knee_error_px(load_capture(root, fps=60.0), demo) < 0.1
    (root / "keypoints.json").write_text(json.dumps({"order": list(NAMES[:-1]), "landmarks": OWN}))
    with pytest.raises(KeypointCountMismatch, match=r"A person has 17 keypoints, but .* names 16"):
        load_capture(root, fps=60.0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"landmarks": {"knee": "rigth_knee"}}, "no such landmark: 'knee' is 'rigth_knee'"),
        ({"landmarks": ["knee"]}, "does not define the keypoints"),
        ([1], "does not define the keypoints"),
        ({}, "does not define the keypoints"),
    ],
)
def test_a_bad_file_is_named(tmp_path, demo, content: Any, message: str):
    root = write_dlc(with_calibration(tmp_path / "take", demo), demo)
    (root / "keypoints.json").write_text(json.dumps(content))
    with pytest.raises(FileDamaged, match=message):
        load_capture(root)


def write_sleap(root: Path, demo: Capture) -> Path:
    h5py = pytest.importorskip("h5py", reason="SLEAP's files need h5py: pip install h5py")
    _, keypoints = demo.require_multiview()
    for c, camera in enumerate(demo.require_multiview()[0].names):
        with h5py.File(root / f"labels.v001.00{c}_{camera}.analysis.h5", "w") as file:
            file["node_names"] = [name.encode() for name in keypoints.joint_set.keypoints]
            file["tracks"] = np.moveaxis(keypoints.xy[c], (0, 1, 2), (2, 1, 0))[None]
            file["point_scores"] = keypoints.confidence[c].T[None]
    return root


def test_sleaps_analysis_files(tmp_path, demo):
    root = write_sleap(with_calibration(tmp_path / "take", demo), demo)
    capture = load_capture(root, fps=60.0)
    cameras, keypoints = capture.require_multiview()
    assert cameras.names == demo.require_multiview()[0].names
    assert keypoints.joint_set is JointSet.BODY_25
    np.testing.assert_allclose(keypoints.xy, demo.require_multiview()[1].xy, atol=1e-3)


_ENDS = {kind: (f"{kind}_id_start", f"{kind}_id_end") for kind in ("instance", "point")}


def test_sleaps_labels(tmp_path, demo):
    h5py = pytest.importorskip("h5py", reason="SLEAP's files need h5py: pip install h5py")
    root = with_calibration(tmp_path / "take", demo)
    _, keypoints = demo.require_multiview()
    names, count = keypoints.joint_set.keypoints, keypoints.joint_set.num_keypoints
    about = {"nodes": [{"name": n} for n in names], "skeletons": [{"nodes": [{"id": i} for i in range(count)]}]}
    point = [("x", "f8"), ("y", "f8"), ("visible", "?"), ("complete", "?"), ("score", "f8")]
    for c, camera in enumerate(demo.require_multiview()[0].names):
        points = np.zeros(FRAMES * count, point)
        points["x"], points["y"] = keypoints.xy[c].reshape(-1, 2).T
        points["visible"], points["score"] = True, keypoints.confidence[c].ravel()
        rows = np.arange(FRAMES)
        frames = np.zeros(
            FRAMES, [("video", "i4"), ("frame_idx", "i8"), ("instance_id_start", "i8"), ("instance_id_end", "i8")]
        )
        frames["frame_idx"], frames["instance_id_start"], frames["instance_id_end"] = rows, rows, rows + 1
        instances = np.zeros(
            FRAMES,
            [("instance_type", "u1"), ("from_predicted", "i8"), ("point_id_start", "i8"), ("point_id_end", "i8")],
        )
        instances["instance_type"], instances["from_predicted"] = 1, -1
        instances["point_id_start"], instances["point_id_end"] = rows * count, (rows + 1) * count
        with h5py.File(root / f"{camera}.slp", "w") as file:
            file.create_group("metadata").attrs["json"] = json.dumps(about)
            file["frames"], file["instances"], file["pred_points"] = frames, instances, points
            file["points"] = np.zeros(0, point[:4])
    capture = load_capture(root, fps=60.0)
    np.testing.assert_allclose(capture.require_multiview()[1].xy, keypoints.xy, atol=1e-3)


def test_without_h5py_the_remedy_is_named(tmp_path, demo, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "h5py", None)
    root = with_calibration(tmp_path / "take", demo)
    for ending in (".analysis.h5", "DLC_resnet50_dance.h5"):
        for camera in ("cam01", "cam02"):
            (root / f"{camera}{ending}").touch()
        with pytest.raises(BackendMissing, match="pip install h5py"):
            load_capture(root)
        for path in root.glob("*.h5"):
            path.unlink()


def write_deeplabcut(root: Path, demo: Capture, *, name: str, columns: Any = None) -> Path:
    """Write tables as pandas does with ``format="table"``: names of columns pickled in protocol 0 by PyTables."""
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py: pip install h5py")
    cameras, keypoints = demo.require_multiview()
    names = [
        ("DLC_resnet50", part, coord) for part in keypoints.joint_set.keypoints for coord in ("x", "y", "likelihood")
    ]
    values = np.concatenate([keypoints.xy, keypoints.confidence[..., None]], axis=-1).reshape(len(cameras), FRAMES, -1)
    for c, camera in enumerate(cameras.names):
        rows = np.zeros(FRAMES, [("index", "i8"), ("values_block_0", "f8", (len(names),))])
        rows["index"], rows["values_block_0"] = np.arange(FRAMES), values[c]
        with h5py.File(root / name.format(camera), "w") as file:
            table = file.create_group("df_with_missing").create_dataset("table", data=rows)
            table.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(names if columns is None else columns, 0))
    return root


@pytest.mark.parametrize("name", ["{}DLC_resnet50_dance.h5", "{}.h5"])
def test_deeplabcuts_hdf5_tables(tmp_path, demo, name):
    root = write_deeplabcut(with_calibration(tmp_path / "take", demo), demo, name=name)
    cameras, keypoints = load_capture(root, fps=60.0).require_multiview()
    assert cameras.names == demo.require_multiview()[0].names
    assert keypoints.joint_set is JointSet.BODY_25
    np.testing.assert_allclose(keypoints.xy, demo.require_multiview()[1].xy, atol=1e-3)


@pytest.mark.parametrize("columns", [[Path("/")], "nose", [("a", 1, "x")]])
def test_pickled_names_of_columns_run_no_code(tmp_path, demo, columns):
    root = write_deeplabcut(with_calibration(tmp_path / "take", demo), demo, name="{}DLC.h5", columns=columns)
    with pytest.raises(FileDamaged, match="not a list of strings"):
        load_capture(root, fps=60.0)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("pose/cam01.pkl", r"not supported: Python pickles.*Export JSON or CSV"),
        ("cam01.mat", r"not supported: MATLAB files.*CSV"),
    ],
)
def test_formats_that_are_not_supported_are_named(tmp_path, name, message):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).touch()
    with pytest.raises(CaptureNotRecognised, match=message):
        load_capture(tmp_path)
