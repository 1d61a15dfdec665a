"""Read a capture or a motion in any supported format."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import JobInvalid, MotionInvalid
from solver_backend.exchange.outputs import require_path
from solver_backend.io.motions.motion_checks import checked_motion
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.range_checks import checked
from solver_backend.types import Capture, Motion

if TYPE_CHECKING:
    from solver_backend.io.motions.amass import AmassClip
    from solver_backend.io.motions.bvh import BvhClip

Item = TypeVar("Item")


@dataclass(frozen=True)
class Readers(Iterable[Reader[Item]], Generic[Item]):
    """File readers, in the order in which they are tried. Their modules are imported on demand."""

    rows: tuple[tuple[str, str], ...]  # Module in this package, and name of its reader or tuple of readers.

    def __iter__(self) -> Iterator[Reader[Item]]:
        for module, name in self.rows:
            found: Any = getattr(importlib.import_module(f"solver_backend.io.{module}"), name)
            yield from found if isinstance(found, tuple) else (found,)


CAPTURES: Readers[Capture] = Readers(
    (
        ("own_files", "CAPTURES"),
        ("captures.detection_folders", "READER"),
        ("captures.caliscope", "READER"),
        ("captures.optical_markers", "READERS"),
    )
)
MOTIONS: Readers[Motion | AmassClip | BvhClip] = Readers(
    (("motions.bvh", "READER"), ("motions.amass", "READER"), ("own_files", "MOTION"))
)


def load_capture(path: Path | str, *, readers: Iterable[Reader[Capture]] = CAPTURES, **options: Any) -> Capture:
    """Read a capture with the first reader that recognises the path, and select the person.

    Options are fields of ``ReadOptions``. The capture includes notes on assumptions, and warnings.

    Raises:
        CaptureNotRecognised: no reader recognises the path.
        JobInvalid: an option does not apply to this kind of capture, or the take does not contain the requested frames.
        PersonUnknown: the capture does not contain the requested person.
        CalibrationInvalid, CaptureInvalid: numbers are invalid (see ``range_checks``).
        MocapError: errors that the reader raises.
    """
    path, chosen = Path(os.path.abspath(path)), ReadOptions(**options)
    reader = next((reader for reader in readers if reader.recognises(path)), None)
    if reader is None:
        from solver_backend.io.unsupported import no_capture

        raise no_capture(path, readers)
    capture = reader.open(path, chosen, frozenset({"frames"}))
    if chosen.frames is not None:
        (first, last), count = chosen.frames, capture.num_frames
        if not 0 <= first <= last < count:
            what = f"Frames {first} to {last} are not a valid range in this take of {count} frames."
            raise JobInvalid(what, where="frames", hint=f"Choose frames from 0 to {count - 1}, the earlier one first.")
        capture = capture.frames(first, last + 1)
    if chosen.person is not None:
        capture = capture.of_person(chosen.person)
    if capture.keypoints is not None:
        capture.require_views()
    capture = checked(capture)
    if capture.num_frames == 1:
        capture = replace(capture, problems=(*capture.problems, diagnostic("single_frame")))
    return capture


def load_motion(path: Path | str, **options: Any) -> Motion | AmassClip | BvhClip:
    """Read a motion of this program, or an unconverted clip of another body or skeleton.

    Raises:
        MotionInvalid: no reader recognises the path, or numbers are invalid (see ``motion_checks``).
        MocapError: errors that the reader raises.
    """
    path, chosen = Path(path), ReadOptions(**options)
    reader = next((reader for reader in MOTIONS if reader.recognises(path)), None)
    if reader is None:
        require_path(path)
        kinds = "; ".join(reader.kind for reader in MOTIONS)
        raise MotionInvalid("The path is not a readable motion.", where=str(path), hint=f"Motions are {kinds}.")
    motion = reader.open(path, chosen)
    checked_motion(motion, str(path))
    return motion
