"""Every reading option is applied or refused by name, for every kind of capture and motion."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import JobInvalid, MocapError
from solver_backend.exchange.reading_settings import DEFAULTS
from solver_backend.io.load import CAPTURES, MOTIONS, load_capture, load_motion
from solver_backend.io.markers.live_recording import LiveBlock, pack_block
from solver_backend.io.markers.read import write_markers
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.io.reader import Reader, option_name
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, JointSet, MarkerCloud
from tests.support.calibration_files import qca_text, toml_text
from tests.support.marker_texts import TEXTS
from tests.support.scenes import small_motion
from tests.support.trial_files import write_trial

VALUES: dict[str, Any] = {
    "fps": 33.0, "joint_set": JointSet.HALPE_26, "unit": "inch", "up_axis": "x", "trim": True, "as_calibrated": True,
    "subject_prefix": "xx", "person": "xx", "camera": ("foo=bar",), "offset": ("foo=3",), "by_order": True,
    "frames": (1, 2), "stature": 1.66, "scale": 2.0, "level": "on", "camera_path": "foo.txt",
}  # fmt: skip
"""One value of each option that is not its default."""
MENTIONS = {"joint_set": ("keypoints",), "camera": ("foo",), "offset": ("foo",), "level": ("stand", "level"),
            "camera_path": ("foo.txt", "path")}  # fmt: skip
"""What an error about an option may say instead of its name."""
UNSEEN = {"trim", "as_calibrated", "by_order"}
"""Options that change nothing in captures whose cameras agree and have the same frames."""


def _cloud() -> MarkerCloud:
    places = np.array([[0.1, 0.2, 1.5], [0.2, 0.1, 0.1], [0.1, -0.1, 0.9], [-0.2, 0.3, 1.1], [0.3, -0.2, 0.4]])
    way = 0.01 * np.arange(6)[:, None, None] * [1.0, 0.5, 0.2]
    return MarkerCloud(places + way, 50.0, ("C7", "LTOE", "LANK", "RANK", "LKNE"))


def _text(name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_text(TEXTS[name])
        return folder / name

    return write


def _trial(folder: Path) -> Path:
    write_trial(folder / "trial", frames=24)
    return folder / "trial"


def _qualisys_trial(folder: Path) -> Path:
    cameras = write_trial(folder / "trial", frames=24)
    (folder / "trial/calibration/Calib.toml").unlink()
    names = ("cam_1", "cam_2", "cam_3", "cam_4")
    (folder / "trial/calibration/Calib.qca.txt").write_text(qca_text(replace(cameras, names=names)))
    return folder / "trial"


def _caliscope(folder: Path) -> Path:
    capture = demo_capture(num_frames=24)
    cameras, found = capture.require_multiview()
    (folder / "config.toml").write_text(toml_text(replace(cameras, names=tuple(f"cam_{c}" for c in range(4)))))
    with (folder / "xy_POSE.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["sync_index", "port", "point_id", "img_loc_x", "img_loc_y"])
        rows.writerows([f, c, k, *found.xy[c, f, k]] for c, f, k in np.argwhere(found.confidence > 0))
    return folder / "xy_POSE.csv"


def _array(folder: Path) -> Path:
    np.save(folder / "points.npy", _cloud().positions)
    (folder / "points.txt").write_text("\n".join(_cloud().labels or ()))
    return folder / "points.npy"


def _live(folder: Path) -> Path:
    blocks = [LiveBlock(k / 50.0, p.astype(np.float32), 50.0, np.eye(3)) for k, p in enumerate(_cloud().positions)]
    (folder / "live.c3d.recording").write_bytes(b"".join(map(pack_block, blocks)))
    return folder / "live.c3d.recording"


def _matlab(folder: Path) -> Path:
    matlab = pytest.importorskip("scipy.io")
    data = np.concatenate([1000 * np.moveaxis(_cloud().positions, 0, 2), np.zeros((5, 1, 6))], axis=1)
    labeled = {"Count": 5, "Labels": np.array(_cloud().labels, dtype=object), "Data": data}
    matlab.savemat(folder / "q.mat", {"q": {"Frames": 6, "FrameRate": 50, "Trajectories": {"Labeled": labeled}}})
    return folder / "q.mat"


def _trc_text(folder: Path) -> Path:
    return write_markers(folder / "t.trc", _cloud()).rename(folder / "t.txt")


def _bvh(folder: Path) -> Path:
    head = "HIERARCHY\nROOT Hips {\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\n"
    (folder / "a.bvh").write_text(f"{head}MOTION\nFrames: 2\nFrame Time: 0.1\n1 2 3 4 5 6\n")
    return folder / "a.bvh"


def _amass(folder: Path) -> Path:
    np.savez(folder / "b.npz", poses=np.zeros((3, 156)), trans=np.zeros((3, 3)), mocap_framerate=np.array(30.0))
    return folder / "b.npz"


CAPTURE_FILES: tuple[Callable[[Path], Path], ...] = (
    lambda folder: write_capture(folder / "views.npz", demo_capture(num_frames=24)),
    lambda folder: write_capture(folder / "markers.npz", Capture("m", markers=_cloud())),
    _trial,
    _caliscope,
    lambda folder: write_markers(folder / "t.c3d", _cloud()),
    lambda folder: write_markers(folder / "t.trc", _cloud()),
    _trc_text,
    _text("motive.csv"),
    _text("nexus.csv"),
    _array,
    _text("qtm.tsv"),
    _matlab,
    _text("points.csv"),
    _live,
)
"""Writes a file of each reader, in the order of ``CAPTURES``."""
MOTION_FILES: tuple[Callable[[Path], Path], ...] = (
    _bvh, _amass, lambda folder: write_motion(folder / "m.npz", small_motion(3)),
)  # fmt: skip
"""Writes a file of each reader, in the order of ``MOTIONS``."""


def test_every_option_and_every_reader_is_tried() -> None:
    assert VALUES.keys() == DEFAULTS.keys()
    assert all(VALUES[name] != DEFAULTS[name] for name in VALUES)
    assert len(list(CAPTURES)) == len(CAPTURE_FILES) and len(list(MOTIONS)) == len(MOTION_FILES)
    for reader in (*CAPTURES, *MOTIONS):
        assert reader.takes <= VALUES.keys()


def _facts(capture: Capture) -> tuple[object, ...]:
    """Return what an option may change in a capture."""
    cameras, found, markers = capture.cameras, capture.keypoints, capture.markers
    return (
        capture.fps, capture.num_frames, capture.stature_m, capture.notes, capture.problems,
        None if cameras is None else (cameras.t.tolist(), cameras.R.tolist()),
        None if found is None else found.joint_set,
        None if markers is None else markers.positions.tolist(),
    )  # fmt: skip


def _read(path: Path, options: dict[str, Any]) -> Capture | MocapError:
    try:
        return load_capture(path, **options)
    except MocapError as error:
        return error


@pytest.mark.parametrize("write", CAPTURE_FILES, ids=[reader.kind[:24] for reader in CAPTURES])
def test_a_capture_applies_an_option_or_refuses_it_by_name(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    reader = list(CAPTURES)[CAPTURE_FILES.index(write)]
    path = write(tmp_path)
    assert next(row for row in CAPTURES if row.recognises(path)).kind == reader.kind
    needed: dict[str, Any] = {"fps": 50.0} if path.suffix == ".npy" else {}  # arrays state no rate
    if "as_calibrated" in reader.takes:  # or each reading would compare the cameras with the detections
        needed["as_calibrated"] = True
    plain = repr(_facts(load_capture(path, **needed)))
    for name, value in VALUES.items():
        found = _read(path, {**needed, name: value})
        if name not in reader.takes | {"frames"}:
            assert isinstance(found, JobInvalid) and f"({option_name(name)}) does not apply" in str(found)
        elif isinstance(found, MocapError):
            said = f"{found} {found.where} {found.hint}"
            assert any(word in said for word in (option_name(name), name, *MENTIONS.get(name, ()), "xx")), said
        else:
            assert name in UNSEEN or repr(_facts(found)) != plain, name
    with pytest.raises(JobInvalid, match=r"Unknown unit 'bananas'|\(--unit\) does not apply"):
        load_capture(path, unit="bananas")
    with pytest.raises(JobInvalid, match=r"axis 'q'|'q'|\(--up-axis\) does not apply"):
        load_capture(path, up_axis="q")


@pytest.mark.parametrize("write", MOTION_FILES, ids=[reader.kind for reader in MOTIONS])
def test_a_motion_applies_an_option_or_refuses_it_by_name(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    reader: Reader[Any] = list(MOTIONS)[MOTION_FILES.index(write)]
    path = write(tmp_path)
    plain = repr(load_motion(path))
    for name, value in VALUES.items():
        if name in reader.takes:
            assert repr(load_motion(path, **{name: value})) != plain
        else:
            with pytest.raises(JobInvalid, match=rf"\({option_name(name)}\) does not apply"):
                load_motion(path, **{name: value})


def test_the_unit_of_a_qualisys_calibration_is_what_is_given(tmp_path: Path) -> None:
    path = _qualisys_trial(tmp_path)
    stated, given = (load_capture(path, as_calibrated=True, **options) for options in ({}, {"unit": "cm"}))
    assert stated.cameras is not None and given.cameras is not None
    apart = [np.linalg.norm(c.centres[1] - c.centres[0]) for c in (stated.cameras, given.cameras)]
    np.testing.assert_allclose(apart[1], 10 * apart[0], rtol=1e-9)
    with pytest.raises(JobInvalid, match="Unknown unit 'bananas'"):
        load_capture(path, unit="bananas")
