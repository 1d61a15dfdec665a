"""Readers of motions, bodies, weights, and of what the halves of the program tell each other."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from blender_addon.body.body_file import read_body
from blender_addon.headless.batch.record import NAME as RECORD
from blender_addon.headless.batch.record import is_step_done, read_record
from research.priors import load_svae
from solver_backend.body.body import load_body
from solver_backend.body.files.choices import load_smpl_file
from solver_backend.exchange import motion_file
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.npz import read_npz
from solver_backend.io.load import load_motion
from solver_backend.io.motions.acclaim import read_acclaim
from solver_backend.io.motions.motion_checks import check_motion
from solver_backend.io.motions.network_results import is_network_result, read_network_result
from solver_backend.io.native.motion_file import read_motion, read_subject, write_motion
from solver_backend.job import Job
from solver_backend.priors.weights import arrays_hash
from tests.body.oracle import model
from tests.fuzz import odd_bodies, odd_motions
from tests.fuzz.odd_bodies import ARCHIVES
from tests.fuzz.odd_bodies import body as _body
from tests.fuzz.odd_values import RECORDS, variants
from tests.fuzz.target import Target, Write, file, is_folder, large, nothing
from tests.support.acclaim_skeleton import AMC, ASF
from tests.support.network_files import FilmedMotion, write_network_file
from tests.support.random_weights import write_random
from tests.support.scenes import small_motion

_NPZ = {".npz": "npz"}
_BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Knee
  {
    OFFSET 0 -40 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -40 5
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.02
0 90 0 1 2 3 4 5 6
0 91 0 1 2 3 4 5 7
"""


_SIX = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
_MOVING = _BVH.replace("CHANNELS 3 Zrotation Xrotation Yrotation", _SIX)
_MOVING = _MOVING.replace(" 4 5 6\n", " 0 -40 0 4 5 6\n").replace(" 4 5 7\n", " 0 -41 0 4 5 7\n")
_ADDED = _MOVING.replace(" 0 -40 0 4", " 0 0.1 0 4").replace(" 0 -41 0 4", " 0 0.2 0 4")
_LONG = "HIERARCHY\n" + "x" * 5_100_000 + "\nMOTION\nFrames: 1\nFrame Time: 0.1\n"
_CROWD = "ROOT a\n{\n OFFSET 0 0 0\n" + "JOINT b\n{\n OFFSET 0 0 0\n}\n" * 1100 + "}\n"
_ODD_BVH = (
    "", "no motion", _BVH.replace("OFFSET 0 -40 0", "OFFSET 0 -40"), _BVH.replace("Frames: 2", "Frames: -1"),
    _BVH.replace("Time: 0.02", "Time: inf"), _BVH.replace("Frames: 2", "Frames: 9000000"),
    _BVH.replace("Frames: 2", "Frames: 3"), _BVH.replace("91", "nan"), _BVH.replace("91", "1e999"),
    _BVH.replace("CHANNELS 6", "CHANNELS 0").replace("CHANNELS 3", "CHANNELS 0"), _BVH.replace("}", "", 1),
    "HIERARCHY\nROOT a\n{\n OFFSET 0 0 0\n CHANNELS 0\n}\nMOTION\nFrames: 1\nFrame Time: 0.1\n",
    f"HIERARCHY\n{_CROWD}MOTION\nFrames: 1\nFrame Time: 0.1\n", _BVH.replace("ROOT", "ROOT a {} ROOT"),
    _BVH.replace("Frame Time: 0.02", "Frame Time: 0.02 x"), _BVH.replace("JOINT Knee", "JOINT").replace("End", "END"),
)  # fmt: skip


def _job(folder: Path) -> None:
    pin = {"frame": 3, "global_orient": [0.0] * 3, "body_pose": [0.1] * 69, "transl": [0.0] * 3}
    values = {
        "version": 1, "capture": "c.npz", "out": "m.npz", "report": "p.html", "overwrite": True, "fps": 30.0,
        "trim": True, "joint_set": "COCO_17", "unit": "m", "up_axis": "z",
        "settings": {"window": 20, "method": "global"},
        "resolve": {"motion": "e.npz", "first": 1, "last": 5, "pins": [pin]},
    }  # fmt: skip
    (folder / "job.json").write_text(json.dumps(values))


def _record(folder: Path) -> None:
    record = {"take": "a", "status": "done", "inputs": "ab12", "outputs": ["a.npz"], "solve": {"frames": 3}}
    record["steps"] = {"solve": {"key": "ab12", "outputs": ["a.npz"], "notes": [], "seconds": 1.5}}
    record["attempts"] = [{"step": "solve", "worker": "", "how": "done"}]
    (folder / RECORD).write_text(json.dumps(record))


def _motion(optional: bool = True) -> Write:
    return lambda folder: write_motion(folder / "a.npz", small_motion(2, optional))


def amass(parts: bool = False, width: int = 156, model_type: str = "") -> Write:
    """Return what writes poses as AMASS has them."""

    def write(folder: Path) -> None:
        rng = np.random.default_rng(0)
        arrays = {"trans": rng.normal(size=(4, 3)), "betas": rng.normal(size=16), "mocap_framerate": np.array(120.0)}
        if parts:
            arrays |= {"root_orient": rng.normal(size=(4, 3)), "pose_body": rng.normal(size=(4, 63))}
            arrays |= {"pose_hand": rng.normal(size=(4, 90)), "surface_model_type": np.array(model_type)}
        else:
            arrays["poses"] = rng.normal(size=(4, width))
        np.savez(folder / "a.npz", **arrays, gender=np.array("male"))

    return write


def _pickled(protocol: int) -> Write:
    plain = {name: value for name, value in model("SMPL").items() if value.dtype != object}
    return file("a.pkl", pickle.dumps(plain | {"bs_style": "lbs"}, protocol=protocol))


def _weights(folder: Path) -> None:
    write_random(folder / "a.npz", "svae")


def _weights_of(change: dict[str, object]) -> Write:
    """Return what writes weights with another header."""

    def write(folder: Path) -> None:
        _weights(folder)
        with np.load(folder / "a.npz") as stored:
            header = json.loads(str(stored["header"])) | change
        odd_motions.changed(_weights, header=json.dumps(header))(folder)

    return write


_HEADERS: tuple[dict[str, object], ...] = (
    {"format": "other"}, {"version": 99}, {"prior": "other"}, {"body_joints": [1]}, {"body_joints": None},
)  # fmt: skip


_ODD_WEIGHTS = (np.array("a"), np.zeros((3, 3)), np.full((24, 32), np.nan, np.float32), None)


def read_as_if_whole(folder: Path, load: Callable[[Path], object]) -> object:
    """Read changed weights under the hash of what was changed, as somebody who forges them would write it."""
    path, forged = folder / "a.npz", folder / "forged.npz"
    try:
        arrays = read_npz(path)
        header = json.loads(str(arrays.pop("header")))
        np.savez(forged, header=np.array(json.dumps(header | {"sha256": arrays_hash(arrays)})), **arrays)
    except (MocapError, ValueError, KeyError, TypeError, RecursionError):
        return load(path)
    return load(forged)


def _shown(folder: Path) -> object:
    path = next(iter(sorted(folder.iterdir())), folder / "a.npz")
    return motion_file.is_motion(path) and motion_file.read_motion(path)


def _read_record(folder: Path) -> object:
    record = read_record(folder)
    return None if record is None else is_step_done(record, folder, "solve", "ab12")


_NETWORKS = ("WHAM", "PromptHMR", "4D-Humans", "SAM 3D Body", "InstantHMR", "MediaPipe", "RTMW3D", "MotionBERT")
"""Programs whose files need no PyTorch to be written."""


@cache
def _network_bytes(program: str) -> tuple[str, bytes]:
    """Return the name and content of a program's file of two frames."""
    turns = np.tile(np.eye(3), (2, 21, 1, 1))
    motion = FilmedMotion(load_body(), turns[:, 0], turns, np.ones((2, 3)), np.eye(3), np.array([0.0, 1.0, 4.0]))
    with TemporaryDirectory() as folder:
        path = write_network_file(program, motion, Path(folder))
        return path.name, path.read_bytes()


def _network(program: str) -> Write:
    def write(folder: Path) -> None:
        name, content = _network_bytes(program)
        (folder / name).write_bytes(content)

    return write


def _tram(folder: Path) -> None:
    """Write TRAM's dictionary in an array of objects, with NumPy's arrays."""
    content: Any = {"pred_rotmat": np.tile(np.eye(3), (2, 24, 1, 1)), "pred_trans": np.ones((2, 1, 3))}
    np.save(folder / "hps_track_0.npy", content | {"frame": np.arange(2)}, allow_pickle=True)


def _acclaim(folder: Path) -> None:
    (folder / "a.asf").write_text(ASF)
    (folder / "a.amc").write_text(AMC)


def _read_network(folder: Path) -> object:
    path = next(iter(sorted(folder.iterdir())), folder / "a.pkl")
    return is_network_result(path) and read_network_result(path)


TARGETS: tuple[Target, ...] = (
    Target(
        "result of a network",
        tuple(map(_network, _NETWORKS)),
        _read_network,
        {".pkl": "pickle", ".npz": "npz", ".npy": "binary", ".pt": "binary", ".json": "json"},
        (_tram, file("a.pt", "x"), file("a.pkl", pickle.dumps({"weights": [1.0]}))),
        (nothing, is_folder("a.pkl")),
    ),
    Target(
        "BVH",
        (file("a.bvh", _BVH), file("a.bvh", _MOVING), file("a.bvh", _ADDED)),
        lambda f: load_motion(f / "a.bvh"),
        {".bvh": "text"},
        (*(file("a.bvh", text) for text in _ODD_BVH), file("b.bvh", "HIERARCHY")),
        (file("a.bvh", _LONG), large("a.bvh", 10**9), is_folder("a.bvh")),
    ),
    Target(
        "ASF and AMC",
        (_acclaim,),
        lambda f: read_acclaim(f / "a.amc"),
        {".amc": "text", ".asf": "text"},
        (file("a.amc", AMC), file("a.asf", ASF)),
        (is_folder("a.amc"), nothing, large("a.amc", 10**9)),
    ),
    Target(
        "AMASS",
        (amass(), amass(width=72), amass(width=165), amass(parts=True, model_type="smplx")),
        lambda f: load_motion(f / "a.npz"),
        _NPZ,
        (
            *(odd_motions.changed(amass(), **arrays) for arrays in odd_motions.AMASS),
            odd_motions.changed(amass(parts=True), pose_hand=None, surface_model_type=None),
            odd_motions.changed(amass(parts=True), root_orient=None),
        ),
        (nothing,),
    ),
    Target(
        "motion file",
        (_motion(), _motion(False)),
        lambda f: check_motion(load_motion(f / "a.npz")),
        _NPZ,
        odd_motions.MOTIONS,
    ),
    Target(
        "motion file, strict",
        (_motion(), _motion(False)),
        lambda f: read_motion(f / "a.npz"),
        _NPZ,
        (amass(), *odd_motions.MOTIONS),
    ),
    Target("subject file", odd_motions.SUBJECTS, lambda f: read_subject(f / "a.npz"), _NPZ, odd_motions.ODD_SUBJECTS),
    Target(
        "motion file, shown",
        (_motion(), amass(), amass(parts=True)),
        _shown,
        _NPZ,
        (*ARCHIVES, *odd_motions.MOTIONS),
        (file("a.bvh", _BVH), nothing),
    ),
    Target("body .npz", (_body("SMPL"), _body("SMPL-H")), lambda f: load_smpl_file(f / "a.npz"), _NPZ),
    Target(
        "body .npz, relaxed hands",
        (_body("SMPL-X"),),
        lambda f: load_smpl_file(f / "a.npz", flat_hands=False),
        _NPZ,
        odd_bodies.RELAXED,
    ),
    Target(
        "body .npz, one family",
        (_body("SMPL"),),
        lambda f: load_smpl_file(f / "a.npz", family="SMPL"),
        _NPZ,
        (_body("SMPL-H"), odd_motions.changed(_body("SMPL"), kintree_table=None)),
    ),
    Target(
        "body .npz, shown",
        (_body("SMPL"), _body("SMPL-H")),
        lambda f: read_body(f / "a.npz"),
        _NPZ,
        odd_bodies.SHOWN,
        (nothing,),
    ),
    Target("body of another kind, shown", (), lambda f: read_body(f / "a.pkl"), {".pkl": "pickle"}, (_pickled(2),)),
    Target(
        "body .pkl",
        (_pickled(2), _pickled(4)),
        lambda f: load_smpl_file(f / "a.pkl"),
        {".pkl": "pickle"},
        tuple(file("a.pkl", content) for content in odd_bodies.PICKLES),
        (odd_bodies.BOMB,),
    ),
    Target(
        "weights",
        (_weights,),
        lambda f: read_as_if_whole(f, load_svae),
        _NPZ,
        (
            *map(_weights_of, _HEADERS),
            *(odd_motions.changed(_weights, decoder_w0=value) for value in _ODD_WEIGHTS),
        ),
        (nothing,),
    ),
    Target(
        "job file",
        (_job,),
        lambda f: Job.read(f / "job.json").as_dict(),
        {".json": "json"},
        (*odd_motions.JOBS, *odd_motions.NO_JOBS),
        (large("job.json", 10**8), nothing),
    ),
    Target(
        "record of a batch",
        (_record,),
        _read_record,
        {".json": "json"},
        variants({"take": "a", "status": "done"}, RECORDS, RECORD),
        (nothing, large(RECORD, 10**8)),
    ),
    Target("weights as they are", (_weights,), lambda f: load_svae(f / "a.npz"), _NPZ),
)
"""The add-on's readers of captures and motions are those of ``exchange``; bodies it reads by itself."""
