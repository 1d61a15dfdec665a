"""Find a recording's calibration in its folder, next to it, or in the folders above."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
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
from solver_backend.io.files import LARGEST_TEXT, read_text
from solver_backend.types import Cameras

CONFIG = "Config.toml"
MOST_LEVELS = 5
"""Largest number of folder levels to search, starting at the recording. Chosen by hand."""
AGREES_BY_NAME = 0.7
"""Fraction of agreeing keypoints above which cameras are assigned by name, without other attempts."""
CLEARLY_BETTER = 0.2
"""Smallest increase in the fraction of agreeing keypoints for which another calibration replaces the first."""
_CALIBRATION = re.compile(r"calib(ration)?s?\d*([_\-\s.].*)?|.+[_\-\s.]calib(ration)?s?", re.IGNORECASE)
_CAMERAS = ("cameras", "camera_parameters", "camera_params", "sparse", "sparse/0", "colmap", "colmap/sparse/0")
"""Calibration folders of AIST++, Fit3D and COLMAP next to a recording."""
_OPENCAP, _MAPPING = "Videos", "mapping.txt"
"""OpenCap's folder with one subfolder per camera, and AIST++'s file that lists the cameras of each take."""
_SESSION = re.compile(r"^S\d+(_P\d+)?", re.IGNORECASE)
_PICKLE = "another kind of pickle", "Name an array pickle calibration.pkl, or write the arrays as JSON."
_UNSUPPORTED = {
    ".mat": ("a MATLAB file", "Write K, R and t of each camera as JSON, with MATLAB's jsonencode."),
    ".pkl": _PICKLE,
    ".pickle": _PICKLE,
    ".cal": ("a binary calibration", "Export it as text: OpenCV's YAML, or one projection matrix per camera."),
}
"""For each unsupported suffix, the name of the file type and a way to convert it."""


ByViews = Callable[[Cameras, list[int] | None], list[int] | None]
"""Assigns calibrated cameras to recorded ones by their views. Its second argument is an assignment by name or order."""


def levels_above(root: Path) -> list[Path]:
    """List a folder, its parent, and the folders above them that belong to the same recording.

    The search goes up as long as the current folder contains a Config.toml or has a Pose2Sim name such as
    ``S00_P00_...``.
    """
    levels = [root, root.parent]
    while len(levels) < MOST_LEVELS:
        below = levels[-1]
        if not ((below / CONFIG).is_file() or _SESSION.match(below.name)) or below.parent == below:
            break
        levels.append(below.parent)
    return levels


def is_calibration_folder(path: Path) -> bool:
    """Return whether a path is a folder whose name suggests a calibration."""
    return path.is_dir() and _CALIBRATION.fullmatch(path.name) is not None


def holds_cameras(path: Path) -> bool:
    """Return whether a folder's name suggests a calibration, or is in ``_CAMERAS``."""
    return path.name.lower() in _CAMERAS or is_calibration_folder(path)


def find_calibration(
    root: Path,
    recorded: Sequence[str],
    *,
    unit: str | None = None,
    up_axis: str | None = None,
    names: Mapping[str, str] | None = None,
    by_views: ByViews | None = None,
    agreement: Callable[[Cameras], float] | None = None,
) -> Calibration:
    """Find the calibration nearest to a recording. Return its cameras in the recorded order.

    Args:
        recorded: names of the recorded cameras.
        unit: see ``read_calibration``.
        names: calibrated name of each recorded camera, for names that differ.
        by_views: assigns cameras if no calibration contains the recorded names and ``names`` is empty.
        agreement: returns the fraction of keypoints that agree between views, given cameras in the recorded order. It
            is used to choose between several calibrations in one folder.

    Raises:
        CalibrationMissing: no calibration was found.
        JobInvalid: an entry of ``names`` is not a recorded camera.
        CalibrationMismatch: every calibration is for other cameras.
    """
    names = names or {}
    if unknown := [name for name in names if name not in recorded]:
        hint = f"The recorded cameras are {listing(recorded)}."
        raise JobInvalid(f"No recorded camera is called {listing(unknown)}.", where="camera", hint=hint)
    called = [names.get(name, name) for name in recorded]
    others: list[Calibration] = []
    damaged: list[MocapError] = []
    levels = levels_above(root)
    for folder in _folders(root):
        inner = holds_cameras(folder) or folder.name == _OPENCAP
        found, errors = calibrations_in(folder, unit=unit, up_axis=up_axis, nested=inner)
        if len(found) > 1:
            found = _of_take(root, folder, found)
        orders = [match_names(called, calibration.cameras.names) for calibration in found]
        named = [(calibration, order) for calibration, order in zip(found, orders, strict=True) if order is not None]
        if named:
            fitting = [ordered(*pair, recorded) for pair in named]
            if agreement is None:
                return fitting[0]
            if len(fitting) > 1:
                return _best_of(fitting, agreement)
            if by_views is None or names:
                return fitting[0]
            return _others_of_more(*named[0], fitting[0], recorded, by_views, agreement)
        others += found
        # A damaged file in a calibration folder is a damaged calibration. Elsewhere it may be anything.
        meant = is_calibration_folder(folder)
        broken = [e for e in errors if not isinstance(e, CalibrationMissing)]
        serious = [e for e in broken if meant or (folder in levels and isinstance(e, CalibrationInvalid))]
        if serious:
            raise serious[0]
        meant = meant or folder == root or (folder not in levels and folder.name != _OPENCAP)
        damaged += [e for e in errors if meant or isinstance(e, CalibrationInvalid) or _is_named(e)]
    if not others and (broken := [e for e in damaged if not isinstance(e, CalibrationMissing)]):
        raise broken[0]
    if not others:
        what, how = _name_unsupported(_folders(root)) or ("", "Put one in its 'calibration' folder.")
        what, where = (damaged[0].message, damaged[0].where) if damaged else (what, str(root))
        what = f"The recording has no camera calibration. {what}".rstrip()
        raise CalibrationMissing(what, where=where, hint=f"{how} Supported formats: {FORMATS}.")
    if by_views is not None and not names:
        for calibration in others:
            order = by_views(calibration.cameras, counted_order(recorded, calibration.cameras.names))
            if order is not None:
                first = calibration.cameras.names[order[0]]
                return _assigned_by_views(ordered(calibration, order), recorded, calibrated=first)
    raise _mismatch(root, others, recorded)


def _is_named(error: MocapError) -> bool:
    """Return whether an error is about a file whose name suggests a calibration."""
    return _CALIBRATION.match(Path(error.where or "").stem) is not None


def _mismatch(root: Path, others: Sequence[Calibration], recorded: Sequence[str]) -> CalibrationMismatch:
    for calibration in others:
        if takes := takes_in_names(recorded, calibration.cameras.names):
            hint = "Put each take in a separate folder."
            what = f"The folder contains {len(takes)} takes: {listing(takes)}."
            return CalibrationMismatch(what, where=str(root), hint=hint)
    for calibration in others:
        calibrated = calibration.cameras.names
        keys = {name_key(name) for name in calibrated}
        without = [name for name in recorded if name_key(name) not in keys]
        # True if every calibrated camera is recorded exactly once.
        if without and {name_key(n) for n in recorded} >= keys and len(recorded) - len(without) == len(keys):
            what = f"{listing(without)} {'is' if len(without) == 1 else 'are'} recorded but not calibrated. "
            what += f"{calibration.source.name} is for {listing(calibrated)}."
            hint = "Move detections without a calibrated camera out of the folder, or calibrate all cameras."
            return CalibrationMismatch(what, where=str(calibration.source), hint=hint)
    source, calibrated = others[0].source, others[0].cameras.names
    what = f"The recorded cameras are {listing(recorded)}, but {source.name} is for {listing(calibrated)}."
    hint = f"Assign them with --camera {recorded[0]}={calibrated[0]} and so on. Or give the recorded "
    hint += "cameras the calibrated names (cam01 and cam_1 match), or remove the folders of uncalibrated cameras."
    return CalibrationMismatch(what, where=str(source), hint=hint)


def _others_of_more(
    whole: Calibration,
    by_names: list[int],
    chosen: Calibration,
    recorded: Sequence[str],
    by_views: ByViews,
    agreement: Callable[[Cameras], float],
) -> Calibration:
    """Check cameras that were assigned by name (``chosen``) against the keypoints.

    If the keypoints disagree and the calibration has more cameras than the recording, assign cameras by views.
    """
    if len(whole.cameras) == len(recorded) or agreement(chosen.cameras) >= AGREES_BY_NAME:
        return chosen
    order = by_views(whole.cameras, by_names)
    return chosen if order is None or order == by_names else _assigned_by_views(ordered(whole, order), recorded)


def _assigned_by_views(found: Calibration, recorded: Sequence[str], **calibrated: Any) -> Calibration:
    """Rename a calibration's cameras to the recorded names. Add a warning that lists the pairs of names."""
    pairs = [f"{name} is {camera}" for name, camera in zip(recorded, found.cameras.names, strict=True)]
    assigned = diagnostic("cameras_assigned_by_views", cameras=recorded, pairs=pairs, **calibrated)
    return replace(found, problems=(*found.problems, assigned))


def _best_of(found: Sequence[Calibration], agreement: Callable[[Cameras], float]) -> Calibration:
    shares = [agreement(calibration.cameras) for calibration in found]
    best = max(range(len(found)), key=shares.__getitem__)
    if shares[best] - shares[0] < CLEARLY_BETTER:
        return found[0]
    percent, other, used = 100 * shares[best], 100 * shares[0], found[best].source.name
    chosen = diagnostic(
        "calibration_of_several", used=used, other=found[0].source.name, percent=percent, percent_other=other
    )
    return replace(found[best], problems=(*found[best].problems, chosen))


def _folders(root: Path) -> Iterator[Path]:
    for i, level in enumerate(levels_above(root)):
        with suppress(OSError):
            yield from sorted(path for path in level.iterdir() if is_calibration_folder(path))
        yield from (path for name in (*_CAMERAS, _OPENCAP) if (path := level / name).is_dir())
        if i < 2:
            yield level


def _of_take(root: Path, folder: Path, found: list[Calibration]) -> list[Calibration]:
    """Select the calibrations that AIST++'s mapping file lists for the recorded take. If it lists none, return all."""
    if not (folder / _MAPPING).is_file():
        return found
    rows = (line.split() for line in read_text(folder / _MAPPING, LARGEST_TEXT).splitlines())
    takes = {root.name, *(path.stem for path in root.iterdir())}
    named = {row[1] for row in rows if len(row) == 2 and row[0] in takes}
    return [calibration for calibration in found if calibration.source.stem in named] or found


def ordered(found: Calibration, order: list[int], recorded: Sequence[str] = ()) -> Calibration:
    """Select the cameras with the indices ``order``. Report the omitted cameras, and cameras with another name."""
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


def _name_unsupported(folders: Iterable[Path]) -> tuple[str, str] | None:
    """Return a sentence and a hint about the first unsupported calibration file, or None if there is none."""
    for folder in folders:
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            if (known := _UNSUPPORTED.get(path.suffix.lower())) is not None:
                return f"{path.name} is {known[0]}, which is not supported.", known[1]
    return None
