"""Create a data set on disk, shot by shot. An interrupted run can be resumed."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.exchange.outputs import check_output, is_free, write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.verb_results import ShotRecord
from solver_backend.exchange.version import VERSION
from solver_backend.io.files import read_json
from solver_backend.synthesis.studio.checked_values import DiskTooSmall, OtherDataSet
from solver_backend.synthesis.studio.make_shot import DONE, make_shot, read_shot
from solver_backend.synthesis.studio.spec import Spec, spec_of
from solver_backend.synthesis.studio.stage import Shot, list_shots, require_sight, set_up

DESCRIPTION, SHOTS = "studio.json", "shots"
_FORMAT = "manifold_mocap_studio"
_BYTES_PER_PIXEL = {"infrared": 1.5, "depth": 1.5, "masks": 0.04, "normals": 0.25, "exr": 9.0, "video": 0.3}
"""Bytes per pixel in PNG, EXR and MP4 files, slightly more than measured for the presets."""
_QUIET_COLOUR = 0.8  # Bytes per pixel of colour images without noise. Noise adds bits in each of the three channels.
_NIGHT_GAIN = 4.0  # Factor on the sensor noise at night.
_BYTES_PER_FRAME = {"pose2sim": 1700, "coco": 700}  # Bytes per view and frame.
_TRUTH_BYTES = 9000  # Bytes per view and frame for ground truth and captures.
_SCENE_BYTES = 260_000  # Bytes per shot for the scene, if there are colour images.
_SPARE = 64 * 2**20  # Bytes that must remain free on the disk. Chosen by hand.


@dataclass(frozen=True)
class Plan:
    """Shots, frames, images and disk space of a data set."""

    shots: tuple[Shot, ...]
    frames: int
    pictures: int
    bytes: int


def plan(spec: Spec) -> Plan:
    """Estimate the size of a described data set. Raise ``FileMissing`` if a motion does not exist."""
    shots = list_shots(spec)
    total, pictures = 0.0, 0
    for shot in shots:
        sizes = shot.array.cameras.image_size
        views = len(sizes)
        area = float((sizes[:, 0] * sizes[:, 1]).sum())
        pictures += views * spec.frames * (len(spec.film) + ("exr" in spec.write))
        per_pixel = sum(_BYTES_PER_PIXEL.get(kind, 0) for kind in (*spec.film, *spec.write))
        if "rgb" in spec.film:
            gain = 1.0 if shot.look.light == "day" else _NIGHT_GAIN
            noise = gain * 255 * math.sqrt(2 * math.pi * math.e) * spec.rgb.noise
            per_pixel += _QUIET_COLOUR + 3 / 8 * math.log2(1 + noise)
            total += _SCENE_BYTES
        total += spec.frames * area * per_pixel
        total += spec.frames * views * (_TRUTH_BYTES + sum(_BYTES_PER_FRAME.get(kind, 0) for kind in spec.write))
    return Plan(shots, spec.frames * len(shots), pictures, int(total))


def check_data_set(spec: Spec, out: Path) -> Plan:
    """Check, without writing anything, that a data set can be made, and return its size.

    Raises:
        OtherDataSet: the folder contains a different data set, or other files.
        DiskTooSmall: the disk has too little space for the remaining shots.
        NobodySeen, CameraInsideBody: a shot cannot be rendered.
        MocapError: a motion cannot be read.
    """
    found = plan(spec)
    _require_own(spec, out)
    done = [shot for shot in found.shots if (out / SHOTS / shot.name / DONE).is_file()]
    needed = int(found.bytes * (1 - len(done) / len(found.shots))) + _SPARE
    free = free_bytes(out)
    if needed > free:
        message = f"The data set needs about {_size(needed)} but the disk has only {_size(free)} free."
        hint = "Film fewer frames, smaller images or fewer kinds of images, or choose another disk."
        raise DiskTooSmall(message, where=str(out), hint=hint)
    # Check one shot per motion and array, because the choice of person hardly affects the view.
    left = {(s.motion.name, s.array.name): s for s in reversed(found.shots) if s not in done}
    for shot in reversed(left.values()):
        require_sight(set_up(spec, shot))
    return found


def open_data_set(spec: Spec, out: Path) -> Plan:
    """Check a data set, and reserve its folder. Raise ``OutputNotWritable`` if that fails."""
    found = check_data_set(spec, out)
    check_output(out / DESCRIPTION, overwrite=True)
    record = {"format": _FORMAT, "version": VERSION, "digest": digest(spec), "folder": str(spec.folder)}
    record |= {"description": json.loads(spec.text), "needed_mb": round(found.bytes / 2**20, 1)}
    write_text(out / DESCRIPTION, json.dumps(record, indent=1, sort_keys=True) + "\n", overwrite=True)
    return found


def make_data_set(spec: Spec, out: Path, progress: Progress = silent, only: Collection[str] = ()) -> list[ShotRecord]:
    """Make every missing shot in a data set, and return the shots' records.

    Args:
        only: names of shots to make in a reserved folder. If empty, reserve the folder and make all.

    Raises:
        FileMissing: there is no shot with this name, or the folder was not reserved.
        MocapError: see ``open_data_set`` and ``make_shot``.
    """
    if only:
        chosen = _chosen(spec, out, only)
        stage = f"filming {len(chosen)} shots"
    else:
        found = open_data_set(spec, out)
        chosen, stage = found.shots, f"filming {_size(found.bytes)}"
    frames = spec.frames * len(chosen)
    records: list[ShotRecord] = []
    progress(stage, 0, frames)
    for number, shot in enumerate(chosen):
        start = number * spec.frames
        records.append(make_shot(spec, shot, out / SHOTS, lambda n, start=start: progress(stage, start + n, frames)))
        progress(stage, start + spec.frames, frames)
    return records


def _chosen(spec: Spec, out: Path, names: Collection[str]) -> tuple[Shot, ...]:
    if _description(out) is None:
        raise FileMissing("The folder does not contain a studio data set.", where=str(out), hint="Begin with --claim.")
    _require_own(spec, out)
    shots = {shot.name: shot for shot in list_shots(spec)}
    if unknown := [name for name in names if name not in shots]:
        message = f"The description has no shot {', '.join(unknown)}."
        raise FileMissing(message, where=str(out), hint="See the output of --plan.")
    return tuple(shots[name] for name in names)


def read_data_set(out: Path) -> tuple[Spec, list[ShotRecord]]:
    """Read the description and the finished shots of a data set. Raise FileMissing or FileDamaged."""
    values = _description(out)
    if values is None:
        raise FileMissing("The folder does not contain a studio data set.", where=str(out))
    folder = values.get("folder", ".")
    if "description" not in values or not isinstance(folder, str):
        raise FileDamaged("The data set description is incomplete.", where=str(out / DESCRIPTION))
    spec = spec_of(values["description"], Path(folder))
    folders = sorted(folder for folder in (out / SHOTS).glob("[!.]*") if (folder / DONE).is_file())
    records = [read_shot(folder) for folder in folders]
    if not records:
        raise FileMissing("The data set has no finished shot.", where=str(out), hint="Run the studio again.")
    return spec, records


def digest(spec: Spec) -> str:
    """Return a hexadecimal hash of a data set's description, which identifies the data set."""
    return hashlib.sha256(spec.text.encode()).hexdigest()[:32]


def _require_own(spec: Spec, out: Path) -> None:
    values = _description(out)
    if values is not None and values.get("digest") != digest(spec):
        hint = "Choose another folder, or use the description that created it."
        raise OtherDataSet("The folder contains a data set made from another description.", where=str(out), hint=hint)
    if values is None and not is_free(out):
        raise OtherDataSet("The folder contains other files.", where=str(out), hint="Choose an empty folder.")


def _description(out: Path) -> dict[str, Any] | None:
    path = out / DESCRIPTION
    if not path.is_file():
        return None
    values = read_json(path)
    return values if isinstance(values, dict) and values.get("format") == _FORMAT else {}


def free_bytes(out: Path) -> int:
    """Return the free space in bytes on the disk of a folder, which may not exist yet."""
    return shutil.disk_usage(next(p for p in (out.resolve(), *out.resolve().parents) if p.exists())).free


def _size(count: float) -> str:
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.0f} MiB"
