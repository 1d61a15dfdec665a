"""Load all recordings that the priors learn from, as clips of body rotations at 30 Hz."""

from __future__ import annotations

import json
import re
import struct
import tarfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.joint_limits import excess_deg
from solver_backend.exchange.errors import FileDamaged, FileMissing, NonFiniteData
from solver_backend.exchange.outputs import open_regular
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import exp_so3, log_so3, rotvec_from_quat
from solver_backend.io.motions.bvh import read_bvh
from solver_backend.io.motions.recorded_clip import RecordedClip, body_rotations, recorded_from_bvh
from training.data.sources.amc_clips import read_amc
from training.data.sources.marker_takes import FIT_FPS, fitted_takes

_ARMS = ((13, 16, 1.0), (14, 17, -1.0))
"""(collar, shoulder, sign of the arm's x in the T-pose). Subtract 1 for columns of SMPL's 21 body joints."""
RAISING_SHARE = 0.22  # Part of the upper arm's elevation that the collar takes over.
REACHING_SHARE = 0.15  # Part of the upper arm's forward swing that the collar takes over.


_FIELDS = ("names", "parents", "offsets", "rotvec", "root", "fps")


def read_clip(path: Path) -> RecordedClip:
    """Read a recorded clip from a file with ``names, parents, offsets, rotvec, root, fps``.

    If a clip starts with its T-pose, that frame is skipped. The optional field ``root_rotvec`` (F, 3) replaces root
    rotations that have only half precision. ``tpose_rotvec`` is optional too.

    Raises:
        FileMissing: the file does not exist.
        FileDamaged: the file is not a clip file, or fields are missing.
        NonFiniteData: a rotation is NaN or infinite.
    """
    if not path.is_file():
        raise FileMissing("The clip is missing.", where=path.name)
    try:
        with open_regular(path) as stream, np.load(stream, allow_pickle=False) as data:
            fields = {key: data[key] for key in data.files}
    except (OSError, ValueError) as error:
        raise FileDamaged("The clip cannot be read.", where=path.name, hint=str(error)) from error
    missing = [key for key in _FIELDS if key not in fields]
    if missing:
        raise FileDamaged(f"The clip lacks {', '.join(missing)}.", where=path.name)
    rotvec = np.array(fields["rotvec"], dtype=np.float64)
    if "root_rotvec" in fields:
        rotvec[:, 0] = fields["root_rotvec"]
    if not np.isfinite(rotvec).all():
        raise NonFiniteData("A rotation of the clip is not a number.", where=path.name)
    names = [str(name) for name in fields["names"]]
    if "tpose_rotvec" not in fields:
        return RecordedClip(
            path.stem, names, fields["parents"], rotvec, np.zeros((len(names), 3)), float(fields["fps"])
        )
    tpose = np.asarray(fields["tpose_rotvec"], dtype=np.float64)
    return RecordedClip(path.stem, names, fields["parents"], rotvec[1:], tpose, float(fields["fps"]))


def resample(rotations: np.ndarray, fps: float, target_fps: float) -> np.ndarray:
    """Resample rotations (F, ..., 3, 3) to another frame rate, along geodesics between neighbouring frames."""
    count = int(np.floor((len(rotations) - 1) * target_fps / fps + 1e-6)) + 1
    position = np.minimum(np.arange(count) * (fps / target_fps), len(rotations) - 1.0)
    first = np.minimum(np.floor(position + 1e-3).astype(int), len(rotations) - 1)
    share = np.clip(position - first, 0.0, 1.0)
    before, after = rotations[first], rotations[np.minimum(first + 1, len(rotations) - 1)]
    if share.max() < 1e-2:
        return before
    step = log_so3(np.swapaxes(before, -1, -2) @ after)
    return before @ exp_so3(share.reshape(-1, *([1] * (step.ndim - 1))) * step)


def with_shoulder_rhythm(rotations: np.ndarray) -> np.ndarray:
    """Make the collars follow the arms. Each upper arm keeps its direction in the frame of the chest.

    The collar rotates by 0.22 of the arm's elevation about z, and by 0.15 of its forward swing about y. The swing is
    multiplied by the cosine of the elevation, because an upright arm has no swing. The shoulder compensates.

    Args:
        rotations: (F, 21, 3, 3) local rotations of the body joints.

    Returns:
        (F, 21, 3, 3) local rotations.

    Reference: after the scapulohumeral rhythm of Inman, Saunders & Abbott 1944, but with zero rotation in the T-pose.
    """
    out = rotations.copy()
    for collar, shoulder, side in _ARMS:
        arm = rotations[:, collar - 1] @ rotations[:, shoulder - 1]
        along = side * arm[:, :, 0]
        elevation = np.arcsin(np.clip(along[:, 1], -1.0, 1.0))
        swing = np.arctan2(along[:, 2], np.abs(along[:, 0])) * np.cos(elevation)
        turn = np.stack((0 * swing, -side * REACHING_SHARE * swing, side * RAISING_SHARE * elevation), axis=-1)
        out[:, collar - 1] = exp_so3(turn)
        out[:, shoulder - 1] = np.swapaxes(out[:, collar - 1], -1, -2) @ arm
    return out


TPOSE = "T-Pose"  # Name of the animation that contains the T-pose.
_FPS = 30.0  # Rate at which curves are sampled, in frames per second. Chosen by hand.
_COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}  # Number of components by element type (glTF 2.0, section 5.1.3).


@dataclass(frozen=True)
class _Scene:
    content: dict[str, Any]
    buffer: bytes

    def array(self, number: int) -> np.ndarray:
        """Return a float accessor as (count, components)."""
        accessor = self.content["accessors"][number]
        view = self.content["bufferViews"][accessor["bufferView"]]
        width = _COMPONENTS[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = np.frombuffer(self.buffer, dtype="<f4", count=accessor["count"] * width, offset=start)
        return values.reshape(-1, width).astype(np.float64)


def read_archive_clips(archive: Path) -> list[RecordedClip]:
    """Read all animations of the ``.glb`` files with a T-pose in a tar archive, sorted by name.

    Raises:
        FileMissing: the archive does not exist.
        FileDamaged: the archive is not readable.
    """
    if not archive.is_file():
        raise FileMissing("The archive of animations is missing.", where=archive.name)
    clips: list[RecordedClip] = []
    try:
        with tarfile.open(archive) as tar:
            members = sorted((m for m in tar if m.isfile() and m.name.endswith(".glb")), key=lambda m: m.name)
            for member in members:
                stream = tar.extractfile(member)
                clips += gltf_clips(stream.read() if stream else b"", member.name)
    except (tarfile.TarError, EOFError, OSError) as error:
        raise FileDamaged("The archive of animations cannot be read.", where=archive.name) from error
    return clips


def gltf_clips(data: bytes, where: str = "") -> list[RecordedClip]:
    """Return the animations of a ``.glb`` file at 30 Hz, or [] if it has no animation named ``T-Pose``.

    Raises:
        FileDamaged: the bytes are not a glTF binary file.
    """
    scene = _parse(data, where)
    nodes, animations = scene.content["nodes"], scene.content.get("animations", [])
    order, parents = _tree(nodes)
    names = [str(nodes[i].get("name", f"node{i}")) for i in order]
    rest = np.array([nodes[i].get("rotation", (0.0, 0.0, 0.0, 1.0)) for i in order], dtype=np.float64)
    rotvecs = {str(a["name"]): _rotvecs(scene, a, order, rest) for a in animations}
    if TPOSE not in rotvecs:
        return []
    tpose = rotvecs.pop(TPOSE)[0]
    return [RecordedClip(name, names, parents, rotvec, tpose, _FPS) for name, rotvec in sorted(rotvecs.items())]


def _parse(data: bytes, where: str) -> _Scene:
    try:
        magic, _, _, length, kind = struct.unpack("<4sII I4s", data[:20])
        if magic != b"glTF" or kind != b"JSON":
            raise ValueError("no glTF header")
        return _Scene(json.loads(data[20 : 20 + length]), data[28 + length :])
    except (struct.error, ValueError) as error:
        raise FileDamaged("The file is not a glTF binary file.", where=where) from error


def _tree(nodes: list[dict[str, Any]]) -> tuple[list[int], np.ndarray]:
    """Return node numbers, parents before children, and the position of each node's parent (-1 for roots)."""
    parent_of = {child: i for i, node in enumerate(nodes) for child in node.get("children", ())}
    order = [i for i in range(len(nodes)) if i not in parent_of]
    for i in order:
        order.extend(nodes[i].get("children", ()))
    place = {node: number for number, node in enumerate(order)}
    return order, np.array([place[parent_of[i]] if i in parent_of else -1 for i in order])


def _rotvecs(scene: _Scene, animation: dict[str, Any], order: list[int], rest: np.ndarray) -> np.ndarray:
    """Return local rotation vectors (F, J, 3) in radians at 30 Hz. Nodes without a channel keep their rest rotation."""
    channels = {
        c["target"]["node"]: animation["samplers"][c["sampler"]]
        for c in animation["channels"]
        if c["target"]["path"] == "rotation"
    }
    times = {node: scene.array(sampler["input"])[:, 0] for node, sampler in channels.items()}
    first, last = min(t[0] for t in times.values()), max(t[-1] for t in times.values())
    at = first + np.arange(round((last - first) * _FPS) + 1) / _FPS
    xyzw = np.repeat(rest[None], len(at), axis=0)
    for number, node in enumerate(order):
        if node in channels:
            xyzw[:, number] = _sampled(times[node], scene.array(channels[node]["output"]), at)
    return rotvec_from_quat(xyzw[..., [3, 0, 1, 2]])


def _sampled(times: np.ndarray, quats: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate quaternions, in any component order, at other times along the shorter path."""
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 1)
    after = np.minimum(before + 1, len(times) - 1)
    gap = times[after] - times[before]
    share = np.clip(np.where(gap > 0, (at - times[before]) / np.where(gap > 0, gap, 1.0), 0.0), 0.0, 1.0)
    unit = quats / np.linalg.norm(quats, axis=-1, keepdims=True)
    a, b = unit[before], unit[after]
    return slerp(a, np.where((a * b).sum(-1, keepdims=True) < 0, -b, b), share)


FPS = 30.0
KEYED = "keyed"
"""Subject of hand-keyed animations."""
UNKNOWN = "unknown"  # Subject of clips from conversions that do not preserve it.
KEYED_ARCHIVE = "mesh2motion_cc0.tar.xz"
FAULT_DEG = 30.0
"""Largest excess over a joint's anatomical range in degrees. With a larger excess, a joint was tracked wrongly."""
FAR = "far"  # Folder of motions that differ from all training motions, for evaluating priors.
_FOLDERS = ("asfamc", "amc", "mb2", "expmap", "max", "daz", "daz_more", "segments", "jump")
"""Folders of converted recordings. If several of them contain a take, the first folder is used."""
_AMC = ("11_01", "13_30", "13_31", "14_14", "14_20")
"""Motions with hands and toes that the other conversions lack. One skeleton file is enough, because all CMU skeletons
have the same axes."""
_TAKE = re.compile(r"(?:[a-z]+_)?(\d+)_\d+")  # CMU's subject and trial in a file name, optionally after a word.
_NUMBERED = ("asfamc", "amc", "mb2", "daz_more", "segments", "jump", FAR)
"""Folders with the subject and trial in the file names."""
_BVH = "makehuman_data_bvhs_10_01.bvh"
_MIN_FRAMES = 3
"""Smallest number of frames in a clip. Chosen by hand."""


@dataclass(frozen=True)
class Clip:
    """A clip of body rotations at 30 Hz, ready for training."""

    name: str  # Source and file, separated by a slash.
    subject: str
    rotations: np.ndarray  # (F, 21, 3, 3) local rotations at 30 Hz, float32.
    root: np.ndarray | None = None  # (F, 3, 3) float32, pelvis rotation since the T-pose, Y up, or None if unknown.


def load_clips(
    data: Path, progress: Progress = silent, *, cache: Path | None = None, fitted: bool = True
) -> list[Clip]:
    """Read CMU's recordings in ``data``, and marker takes and hand-keyed animations if they exist.

    Args:
        data: folder that contains ``motion_cmu``.
        progress: called after every file.
        cache: folder that stores the fitted marker takes, because fitting takes minutes.
        fitted: whether to read the marker takes too.

    Raises:
        FileMissing: the folder contains no clips.
    """
    paths = _one_of_each_take(path for folder in _FOLDERS for path in _recordings(data / "motion_cmu" / folder))
    if not paths:
        hint = "For --data, give the folder that contains motion_cmu."
        raise FileMissing("No training clips were found.", where="motion_cmu", hint=hint)
    clips = []
    for number, path in enumerate(paths):
        clips.append(_recorded(_read(path), path.parent.name, subject_of(path)))
        progress("Reading clips", number + 1, len(paths))
    clips += _makehuman(data / "poses_makehuman_cc0" / _BVH)
    archive = data / KEYED_ARCHIVE
    keyed = read_archive_clips(archive) if archive.is_file() else []
    clips += [_clip(f"{KEYED}/{clip.name}", KEYED, _at_corpus_rate(clip)) for clip in keyed]
    if fitted:
        clips += _marker_takes(data / "markers" / "ui_prmd", cache, progress)
    return [piece for clip in clips for piece in without_faults(clip)]


def load_far_clips(data: Path) -> list[Clip]:
    """Read the motions in ``data`` that differ from all training motions, without frames with tracking faults.

    Returns an empty list if the folder has none.
    """
    clips = [_recorded(read_clip(path), FAR, subject_of(path)) for path in _recordings(data / "motion_cmu" / FAR)]
    return [piece for clip in clips for piece in without_faults(clip)]


def without_faults(clip: Clip) -> list[Clip]:
    """Return the frame ranges of a clip with every joint close to its anatomical range, as separate clips."""
    sound = (excess_deg(clip.rotations.astype(np.float64)) < FAULT_DEG).all(axis=1)
    long = [slice(first, last + 1) for first, last in true_runs(sound) if last - first + 1 >= _MIN_FRAMES]
    root = clip.root
    return [
        Clip(clip.name, clip.subject, clip.rotations[frames], None if root is None else root[frames]) for frames in long
    ]


def subject_of(path: Path) -> str:
    """Return the CMU subject of a clip file, or UNKNOWN for conversions that do not preserve it."""
    folder, take = path.parent.name, _TAKE.match(path.name)
    if folder in _NUMBERED and take:
        return take.group(1)
    if folder == "daz":
        return "60_61" if path.stem.startswith("salsa") else "135"
    return "131" if folder == "max" else UNKNOWN


def _recordings(folder: Path) -> list[Path]:
    """Return the CMU recordings of a folder that belong to the corpus."""
    if folder.name == "amc":
        return [path for name in _AMC if (path := folder / f"{name}.amc.gz").is_file()]
    return sorted(folder.glob("*.npz"))


def _one_of_each_take(paths: Iterable[Path]) -> list[Path]:
    """Return the first file of every numbered take, and all files without a number."""
    first: dict[str, Path] = {}
    for path in paths:
        name = path.name.split(".")[0]
        first.setdefault(name if name[:1].isdigit() else f"{path.parent.name}/{name}", path)
    return list(first.values())


def _read(path: Path) -> RecordedClip:
    return read_amc(path, path.with_name("11.asf")) if path.suffix == ".gz" else read_clip(path)


def _recorded(clip: RecordedClip, source: str, subject: str) -> Clip:
    """Convert a CMU recording to a clip. Its collars do not move, so they get the shoulder rhythm."""
    rotations = _at_corpus_rate(clip)
    rotations[:, 1:] = with_shoulder_rhythm(rotations[:, 1:])
    return _clip(f"{source}/{clip.name}", subject, rotations)


def _clip(name: str, subject: str, rotations: np.ndarray) -> Clip:
    """Return a clip from rotations (F, 22, 3, 3), pelvis first."""
    rotations = rotations.astype(np.float32)
    return Clip(name, subject, rotations[:, 1:], rotations[:, 0])


def _at_corpus_rate(clip: RecordedClip) -> np.ndarray:
    """Return the rotations (F, 22, 3, 3) of the pelvis and the body joints at the frame rate of the corpus."""
    return resample(body_rotations(clip), clip.fps, FPS)


def _makehuman(path: Path) -> list[Clip]:
    return [_recorded(recorded_from_bvh(read_bvh(path), path.stem), "makehuman", "10")] if path.is_file() else []


def _marker_takes(folder: Path, cache: Path | None, progress: Progress) -> list[Clip]:
    takes = fitted_takes(folder, cache, progress) if folder.is_dir() else []
    return [
        Clip(f"ui_prmd/{t.name}", f"ui_prmd_{t.subject}", resample(t.rotations, FIT_FPS, FPS).astype(np.float32))
        for t in takes
    ]
