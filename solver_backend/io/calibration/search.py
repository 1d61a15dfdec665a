"""Find the calibration of a recording: in its folder, beside it, or in the folders above."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import (
    CalibrationInvalid,
    CalibrationMismatch,
    CalibrationMissing,
    JobInvalid,
    MocapError,
)
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.read import FORMATS, calibrations_in
from solver_backend.io.camera_names import counted_order, listing, match_names, name_key, takes_in_names
from solver_backend.types import Cameras

CONFIG = "Config.toml"
MOST_LEVELS = 5
"""Folders above and below that are searched; chosen by hand."""
AGREES_BY_NAME = 0.7
"""Share of the keypoints that agree by the cameras of the recorded names from which no others are looked for."""
CLEARLY_BETTER = 0.2
"""Share of the keypoints that must agree more by another calibration of a folder than by its first."""
_CALIBRATION = re.compile(r"calib(ration)?s?\d*([_\-\s.].*)?|.+[_\-\s.]calib(ration)?s?", re.IGNORECASE)
_SESSION = re.compile(r"^S\d+(_P\d+)?", re.IGNORECASE)
_UNSUPPORTED = {
    ".xcp": ("Vicon's cameras", "Convert it by Pose2Sim's calibration (convert, vicon), which writes a .toml."),
    ".mat": ("a MATLAB file", "Write K, R and t of each camera as JSON, with MATLAB's jsonencode."),
    ".pkl": ("a Python pickle, which runs code when it is read", "Write its arrays with numpy.savez or as JSON."),
    ".pickle": ("a Python pickle, which runs code when it is read", "Write its arrays with numpy.savez or as JSON."),
    ".cal": ("a binary calibration", "Export it as text: OpenCV's YAML, or a projection matrix a camera."),
}
"""What files of each ending are, and the way out."""


def levels_above(root: Path) -> list[Path]:
    """Return the folder, its parent, and those above as far as they belong to the recording.

    A folder above belongs to it while the one below holds a Config.toml or is named like Pose2Sim's ``S00_P00_...``.
    """
    levels = [root, root.parent]
    while len(levels) < MOST_LEVELS:
        below = levels[-1]
        if not ((below / CONFIG).is_file() or _SESSION.match(below.name)) or below.parent == below:
            break
        levels.append(below.parent)
    return levels


def is_calibration_folder(path: Path) -> bool:
    """Whether a folder is named like one that holds a calibration."""
    return path.is_dir() and _CALIBRATION.fullmatch(path.name) is not None


def find_calibration(
    root: Path,
    recorded: Sequence[str],
    *,
    unit: str | None = None,
    up_axis: str | None = None,
    names: Mapping[str, str] | None = None,
    by_views: Callable[[Cameras, list[int] | None], list[int] | None] | None = None,
    agreement: Callable[[Cameras], float] | None = None,
) -> Calibration:
    """Return the nearest calibration that knows the recorded cameras, with its cameras in the recorded order.

    Args:
        root: folder of the recording.
        recorded: names of the recorded cameras.
        unit: length unit of the calibration, see ``read_calibration``.
        up_axis: axis of its world that points up.
        names: calibrated names of recorded cameras whose own names do not give them.
        by_views: assigns calibrated cameras to the recorded ones by what they see, given the assignment by counting;
            asked where no calibration has the recorded names and none were given.
        agreement: share of the keypoints that agree between views by cameras in the recorded order; asked where a
            folder holds several calibrations of these cameras.

    Raises:
        CalibrationMissing: there is none.
        JobInvalid: one of ``names`` is of no recorded camera.
        CalibrationMismatch: there are some, all for other cameras; names both.
        CalibrationInvalid, FileDamaged: a nearer one is bad, or the only files that could be one are damaged.
    """
    called = _called(recorded, names or {})
    others: list[Calibration] = []
    damaged: list[MocapError] = []
    for folder in _folders(root):
        found, errors = calibrations_in(folder, unit=unit, up_axis=up_axis)
        orders = [match_names(called, calibration.cameras.names) for calibration in found]
        named = [(calibration, order) for calibration, order in zip(found, orders, strict=True) if order is not None]
        if named:
            chosen = _best_of([ordered(*pair, recorded) for pair in named], agreement)
            if len(named) > 1 or by_views is None or agreement is None or names:
                return chosen
            return _others_of_more(*named[0], chosen, recorded, by_views, agreement)
        others += found
        # What is broken in a folder of its own is a broken calibration; elsewhere it may be anybody's file.
        serious = [e for e in errors if is_calibration_folder(folder) or isinstance(e, CalibrationInvalid)]
        if serious:
            raise serious[0]
        damaged += [e for e in errors if _may_be_one(e, folder, root)]
    if not others and damaged:
        raise damaged[0]
    if not others:
        what, how = name_unsupported(_folders(root)) or ("", "Put one into its 'calibration' folder.")
        what = f"The recording has no camera calibration. {what}".rstrip()
        raise CalibrationMissing(what, where=str(root), hint=f"{how} Formats that are read: {FORMATS}.")
    if by_views is not None and not names:
        for calibration in others:
            order = by_views(calibration.cameras, counted_order(recorded, calibration.cameras.names))
            if order is not None:
                return _found_by_views(ordered(calibration, order), order, recorded, calibration.cameras.names)
    for calibration in others:
        if takes := takes_in_names(recorded, calibration.cameras.names):
            hint = "Put the detections of each take into a folder of its own."
            what = f"The folder holds {len(takes)} takes: {listing(takes)}."
            raise CalibrationMismatch(what, where=str(root), hint=hint)
    for calibration in others:
        if without := _without_calibration(recorded, calibration.cameras.names):
            raise CalibrationMismatch(
                f"{listing(without)} {'is' if len(without) == 1 else 'are'} recorded and not calibrated: "
                f"{calibration.source.name} is for {listing(calibration.cameras.names)}.",
                where=str(calibration.source),
                hint="Move the detections of what is not calibrated out of the folder, or calibrate all cameras.",
            )
    raise CalibrationMismatch(
        f"The recorded cameras are {listing(recorded)}; the calibration {others[0].source.name} is for "
        f"{listing(others[0].cameras.names)}.",
        where=str(others[0].source),
        hint=f"Assign them with --camera {recorded[0]}={others[0].cameras.names[0]} and so on; or name the cameras "
        "alike (cam01 and cam_1 are alike), or remove folders of cameras without calibration.",
    )


def _may_be_one(error: MocapError, folder: Path, root: Path) -> bool:
    return folder == root or is_calibration_folder(folder) or bool(_CALIBRATION.match(Path(error.where or "").stem))


def _others_of_more(
    whole: Calibration,
    by_names: list[int],
    chosen: Calibration,
    recorded: Sequence[str],
    by_views: Callable[[Cameras, list[int] | None], list[int] | None],
    agreement: Callable[[Cameras], float],
) -> Calibration:
    """Return a calibration by its names, or by the views where it has more cameras and others of them clearly agree.

    Args:
        whole: all its cameras.
        by_names: which of them have the recorded names.
        chosen: those.
        recorded, by_views, agreement: see ``find_calibration``.
    """
    if len(whole.cameras) == len(recorded) or agreement(chosen.cameras) >= AGREES_BY_NAME:
        return chosen
    order = by_views(whole.cameras, by_names)
    if order is None or order == by_names:
        return chosen
    pairs = [f"{name} is {whole.cameras.names[i]}" for name, i in zip(recorded, order, strict=True)]
    others = diagnostic("cameras_assigned_by_views", cameras=recorded, pairs=pairs)
    found = ordered(whole, order)
    return replace(found, problems=(*found.problems, others))


def _best_of(found: Sequence[Calibration], agreement: Callable[[Cameras], float] | None) -> Calibration:
    if len(found) == 1 or agreement is None:
        return found[0]
    shares = [agreement(calibration.cameras) for calibration in found]
    best = max(range(len(found)), key=shares.__getitem__)
    if shares[best] - shares[0] < CLEARLY_BETTER:
        return found[0]
    names: dict[str, Any] = {"used": found[best].source.name, "other": found[0].source.name}
    percent, other = 100 * shares[best], 100 * shares[0]
    chosen = diagnostic("calibration_of_several", **names, percent=percent, percent_other=other)
    return replace(found[best], problems=(*found[best].problems, chosen))


def _without_calibration(recorded: Sequence[str], calibrated: Sequence[str]) -> list[str]:
    keys = {name_key(name) for name in calibrated}
    without = [name for name in recorded if name_key(name) not in keys]
    known = {name_key(name) for name in recorded} & keys
    return without if known == keys and len(recorded) - len(without) == len(keys) else []


def _found_by_views(
    found: Calibration, order: list[int], recorded: Sequence[str], calibrated: Sequence[str]
) -> Calibration:
    pairs = [f"{name} is {calibrated[i]}" for name, i in zip(recorded, order, strict=True)]
    assigned = diagnostic("cameras_assigned_by_views", cameras=recorded, pairs=pairs, calibrated=calibrated[order[0]])
    return replace(found, problems=(*found.problems, assigned))


def _called(recorded: Sequence[str], names: Mapping[str, str]) -> list[str]:
    unknown = [name for name in names if name not in recorded]
    if unknown:
        hint = f"They are {listing(recorded)}."
        raise JobInvalid(f"No recorded camera is called {listing(unknown)}.", where="camera", hint=hint)
    return [names.get(name, name) for name in recorded]


def _folders(root: Path) -> Iterator[Path]:
    for i, level in enumerate(levels_above(root)):
        yield from sorted(path for path in _subfolders(level) if is_calibration_folder(path))
        if i < 2:
            yield level


def _subfolders(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if path.is_dir()]
    except OSError:
        return []


def ordered(found: Calibration, order: list[int], recorded: Sequence[str] = ()) -> Calibration:
    """Return a calibration with its cameras in this order; its notes name those left out, and names that differ."""
    left_out = [name for i, name in enumerate(found.cameras.names) if i not in order]
    notes = (diagnostic("calibrated_not_recorded", cameras=left_out),) if left_out else ()
    pairs = zip(recorded, (found.cameras.names[i] for i in order), strict=bool(recorded))
    if renamed := [(name, camera) for name, camera in pairs if name_key(name) != name_key(camera)]:
        named = [f"{name} is {camera}" for name, camera in renamed]
        notes = (*notes, diagnostic("camera_names_matched", cameras=[name for name, _ in renamed], pairs=named))
    return replace(
        found,
        cameras=found.cameras.subset(order),
        size_known=tuple(found.size_known[i] for i in order),
        notes=(*found.notes, *notes),
    )


def name_unsupported(folders: Iterable[Path]) -> tuple[str, str] | None:
    """Return a sentence on the first such file in the folders, and how to convert it; None where there is none."""
    for folder in folders:
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            if (known := _UNSUPPORTED.get(path.suffix.lower())) is not None:
                return f"{path.name} is {known[0]}, which is not read.", known[1]
    return None
