"""Which share of the readers' lines is executed by the sound files, the corpus and the first inputs of a seed."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from tests.fuzz.corpus import corpus_files, put_in_place
from tests.fuzz.run import Homes, fuzz, how_it_ends, scratch_folder
from tests.fuzz.target import Target

_ROOT = Path(__file__).resolve().parents[2]
_READERS = (
    "solver_backend/io",
    "solver_backend/body/files",
    "solver_backend/exchange/capture_file.py",
    "solver_backend/exchange/json_file.py",
    "solver_backend/exchange/motion_file.py",
    "solver_backend/exchange/npz.py",
    "solver_backend/exchange/npz.py",
    "solver_backend/exchange/schema.py",
    "solver_backend/job.py",
    "solver_backend/priors/weights.py",
    "solver_backend/body/label_places.py",
    "solver_backend/body/marker_layouts.py",
    "solver_backend/live/frames.py",
    "solver_backend/camera_calibration/boards/board.py",
    "solver_backend/videos/detect/detector.py",
    "solver_backend/cameras/noise_map.py",
    "solver_backend/videos/video_detections.py",
    "solver_backend/camera_calibration/intrinsics/known_lenses.py",
    "solver_backend/camera_calibration/intrinsics/known_lenses.py",
    "solver_backend/sensors/devices/recorded.py",
    "solver_backend/sensors/devices/recorded.py",
    "solver_backend/sensors/devices/recorded.py",
    "solver_backend/sensors/wand/views.py",
    "solver_backend/videos/pipeline/plan.py",
    "solver_backend/synthesis/studio/camera_arrays.py",
    "solver_backend/synthesis/studio/spec.py",
    "solver_backend/synthesis/studio/spec.py",
    "solver_backend/synthesis/studio/spec.py",
    "solver_backend/synthesis/studio/checked_values.py",
    "blender_addon/headless/batch/record.py",
    "blender_addon/headless/batch/engines/cluster_task.py",
    "blender_addon/render/picture.py",
    "blender_addon/solving/take_paths.py",
    "blender_addon/studio/places.py",
    "blender_addon/body/body_file.py",
    "blender_addon/retarget/rig_map.py",
    "blender_addon/studio/scene_file.py",
    "blender_addon/body/body_file.py",
    "blender_addon/body/body_file.py",
)
_NO_READERS = ("choices.py",)
"""How the names of files beside the readers end that read nothing."""
_NOT_READING = frozenset(
    {
        "write_npz", "write_capture", "write_motion", "write_subject", "write_weights", "write_sequence", "motion_of",
        "as_motion",
        "rest_joints", "default_body_path", "positions", "_plain",
        "png_bytes", "board_toml", "keep_lenses", "_entry", "write_label_places", "write_map", "map_values", "renamed",
        "fingerprint", "step_key", "write_record", "_size_and_time", "made", "write_png", "put_marker",
        "remove_marker", "shaped", "replayed", "as_dict", "require_body", "starting", "reading",
        "layer_from_render", "blend", "soften_edges", "draw_dots", "gradient", "around", "weight", "applied", "_errors",
        "measure_noise_map", "_pooled", "key_of", "write_c3d", "write_c3d_parts", "_parameter_section", "due_times",
    }
)  # fmt: skip
"""Functions of the readers' files that write, or that compute on what was read."""


class TracedLines:
    """A trace that notes the lines of the readers' files; a function whose lines are all seen costs no more time."""

    def __init__(self, files: Sequence[Path]) -> None:
        self._names = {str(path) for path in files}
        self._missing: dict[CodeType, set[int]] = {}
        self.seen: dict[str, set[int]] = {name: set() for name in self._names}

    def __call__(self, frame: FrameType, event: str, argument: Any) -> Any:
        code = frame.f_code
        if code.co_filename not in self._names:
            return None
        if code not in self._missing:
            self._missing[code] = {line for *_, line in code.co_lines() if line} - {code.co_firstlineno}
        missing, seen = self._missing[code], self.seen[code.co_filename]
        if not missing:
            return None

        def line(frame: FrameType, event: str, argument: Any) -> Any:
            seen.add(frame.f_lineno)
            missing.discard(frame.f_lineno)
            return line if missing else None

        return line


def coverage_table(only: str, count: int, seed: int) -> str:
    """Return a table of the readers' files: lines, those that were reached, and the numbers of the others.

    Args:
        only: how the names of the readers begin that are tried.
        count: of inputs, besides sound, odd and kept files.
        seed: of the mutations.
    """
    files = reader_files()
    lines = TracedLines(files)
    sys.settrace(lines)
    try:
        from tests.fuzz.targets import TARGETS  # readers that are built when their module is loaded are seen so

        targets = [target for target in TARGETS if target.name.startswith(only)]
        _read_corpus(targets)
        fuzz(targets, count, seed)
    finally:
        sys.settrace(None)
    rows, whole, reached = [], 0, 0
    for path in files:
        wanted = _lines_of(path)
        missing = sorted(wanted - lines.seen[str(path)])
        whole, reached = whole + len(wanted), reached + len(wanted) - len(missing)
        if wanted:
            share = 100 * (1 - len(missing) / len(wanted))
            name = path.relative_to(_ROOT).as_posix()
            rows.append(f"{name:<58}{len(wanted):>6}{share:>7.1f} %  {' '.join(map(str, missing))}".rstrip())
    return "\n".join([*rows, f"{'all':<58}{whole:>6}{100 * reached / max(whole, 1):>7.1f} %"])


def _read_corpus(targets: Sequence[Target]) -> None:
    """Read every dialect's sound files, and every file of the corpus."""
    with scratch_folder() as folder:
        homes = Homes(folder)
        for target in targets:
            for dialect in range(len(target.dialects)):
                how_it_ends(target, homes.of(target, dialect)[0])
            for number, write in enumerate(target.once):
                home = folder / f"once {target.name} {number}"
                home.mkdir()
                write(home)
                how_it_ends(target, home)
        for number, (target, path) in enumerate(corpus_files(targets)):
            home = folder / f"corpus{number}"
            home.mkdir()
            put_in_place(target, path, home)
            how_it_ends(target, home)


def reader_files() -> list[Path]:
    """Return the files that hold the readers."""
    found: list[Path] = []
    for name in _READERS:
        path = _ROOT / name
        found += sorted(path.rglob("*.py")) if path.is_dir() else [path]
    return [path for path in found if not path.name.endswith(_NO_READERS) and path.name != "__init__.py"]


def _lines_of(path: Path) -> set[int]:
    """Return the lines of the file's functions that can be executed, but for their first."""
    whole = compile(path.read_text(encoding="utf-8"), str(path), "exec")
    return {line for code in _functions(whole) for *_, line in code.co_lines() if line and line != code.co_firstlineno}


def _functions(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType) and constant.co_name not in _NOT_READING:
            if constant.co_flags & 2:  # CO_NEWLOCALS: a function and no class
                yield constant
            yield from _functions(constant)
