"""Plan the steps for every take, and record their inputs and diagnostics."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from solver_backend.camera_calibration.pictures import opencv
from solver_backend.exchange.diagnostics import Diagnostic, merge, sentence
from solver_backend.exchange.errors import BackendMissing, FileDamaged, MocapError
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.files import read_json
from solver_backend.videos.detect.detector import DetectorChoice
from solver_backend.videos.files.video import PICTURES_FPS
from solver_backend.videos.pipeline.calibrate import KnownOfCameras, calibration_source
from solver_backend.videos.pipeline.layout import FoundFolder, FoundTake

STEPS = ("detect", "sync", "calibrate", "capture", "solve")  # Steps from videos to a motion, in order.
OUTPUTS = {"sync": "sync.json", "calibrate": "calibration.toml", "capture": "capture.npz", "solve": "motion.npz"}
"""Output file of each step except the first, which writes a folder. A calibration is written only if none exists."""


@dataclass(frozen=True)
class TakePlan:
    """Steps planned for one take."""

    take: FoundTake
    folder: Path
    calibration: Calibration | None  # Existing calibration. If None, the cameras will be calibrated.
    problem: str = ""

    def output(self, step: str) -> Path:
        """Return the output file of a step."""
        return self.folder / OUTPUTS[step]


def planned(found: FoundFolder, out: Path) -> list[TakePlan]:
    """Plan the steps of every take. If there are several takes, each one gets an output folder."""
    plans, several = [], len(found.takes) > 1
    for take in found.takes:
        folder, calibration, problem = out / take.name if several else out, None, ""
        try:
            calibration = take.calibration(found.root)
        except MocapError as error:
            problem = str(error)
        plans.append(TakePlan(take, folder, calibration, problem))
    return plans


def described(
    found: FoundFolder, plans: list[TakePlan], detector: str, sync: str, until: str, known: KnownOfCameras
) -> list[str]:
    """Describe the planned steps of all takes as lines of text, for a dry run."""
    lines = [f"{found.root}: {len(plans)} take{'s' * (len(plans) > 1)}"]
    for footage in found.footage:
        lines.append(f"  board footage  {footage.kind} of {len(footage.cameras)} cameras in {footage.folder.name}")
    wanted = STEPS[: STEPS.index(until) + 1]
    for plan in plans:
        lines += [f"  take {plan.take.name}: {', '.join(plan.take.cameras)} → {plan.folder}"]
        steps = {
            "detect": f"keypoints by {detector}, without videos done before",
            "sync": f"clocks of the cameras by {sync}" if sync != "none" else "assumed to be synchronised",
            "calibrate": _calibration_words(plan, found, known),
            "capture": OUTPUTS["capture"],
            "solve": f"{OUTPUTS['solve']} and report.html",
        }
        lines += [f"    {step:<10} {steps[step]}" for step in wanted]
    return lines


_SOURCES = {
    "board": "cameras from the board footage",
    "lenses": "lenses from the board footage, cameras from the person",
    "person": "cameras from the person alone",
}


def _calibration_words(plan: TakePlan, found: FoundFolder, known: KnownOfCameras) -> str:
    if known.source == "auto" and plan.calibration is not None:
        return f"kept: {plan.calibration.source.name}, {len(plan.calibration.cameras)} cameras"
    if known.source == "auto" and plan.output("calibrate").is_file():
        return f"kept: {OUTPUTS['calibrate']}"
    source, lack = calibration_source(found, known), ""
    if source != "person":
        try:
            opencv()
        except BackendMissing as error:
            lack = f"{error.message} {error.hint}"
    return "; ".join(filter(None, (_SOURCES[source], plan.problem, lack)))


@dataclass(frozen=True)
class PipelineSettings:
    """Settings for all steps from videos to a motion."""

    detector: DetectorChoice  # Keypoint detector.
    sync: str = "auto"  # Method of synchronising the clocks, see ``synchronise``.
    until: str = "solve"  # Last step to run.
    jobs: int = 0  # Number of detectors that run simultaneously, or 0 for one per core.
    pictures_fps: float = PICTURES_FPS  # Frame rate of image folders.
    redo: tuple[str, ...] = ()  # Steps to repeat even if nothing has changed.
    overwrite: bool = False  # Whether to replace files that other programs wrote.
    solve: SolveSettings = field(default_factory=SolveSettings)  # Settings for the solve.
    world: WorldSettings = field(default_factory=WorldSettings)  # Scale and levelling of the world.
    cameras: KnownOfCameras = field(default_factory=KnownOfCameras)  # Known facts about uncalibrated cameras.
    hands: DetectorChoice | None = None  # Detector of hands at the wrists. None uses the hands of ``detector``, if any.


NAME = "steps.json"
_BEGUN = ""  # Stored instead of a hash while an output is unfinished.


class Records:
    """Hashes of the inputs of a take's results, stored next to the results. Results with the same inputs are reused."""

    def __init__(self, folder: Path) -> None:
        self._path, kept = folder / NAME, None
        if self._path.is_file():
            with suppress(FileDamaged):
                kept = read_json(self._path)
        self._keys = {str(k): str(v) for k, v in kept.items()} if isinstance(kept, dict) else {}

    def is_made(self, output: Path, made_of: Any) -> bool:
        """Return whether an output exists and was computed from these inputs (JSON values)."""
        return output.is_file() and self._keys.get(output.name) == key_of(made_of)

    def is_ours(self, output: Path) -> bool:
        """Return whether the pipeline wrote an output and may therefore replace it."""
        return output.name in self._keys

    @contextmanager
    def making(self, output: Path, made_of: Any = None) -> Iterator[None]:
        """Mark an output as ours before it is written, so that the next run may replace it if it is incomplete.

        If the inputs ``made_of`` are given, they are recorded after the output has been written.
        """
        self._keys[output.name] = _BEGUN
        self._write()
        try:
            yield
        except BaseException:
            if not output.exists():
                del self._keys[output.name]
                self._write()
            raise
        if made_of is not None:
            self.made(output, made_of)

    def made(self, output: Path, made_of: Any) -> None:
        """Record the inputs (JSON values) of an output."""
        self._keys[output.name] = key_of(made_of)
        self._write()

    def _write(self) -> None:
        write_text(self._path, json.dumps(self._keys, indent=2, sort_keys=True) + "\n", overwrite=True)


def key_of(values: Any) -> str:
    """Return a short hash of JSON values."""
    return hashlib.blake2b(json.dumps(values, sort_keys=True, default=str).encode(), digest_size=12).hexdigest()


ROAD_FILE = "road.json"
FORMAT, VERSION = "manifold_mocap_road", 2  # Version 2 stores ``diagnostics`` where version 1 stored sentences.


class Steps:
    """Finished steps of one take. ``road.json`` is updated after each step."""

    def __init__(self, folder: Path, take: str) -> None:
        self._folder, self._take = folder, take
        self._found: dict[str, tuple[Diagnostic, ...]] = {}
        self._rows: dict[str, dict[str, object]] = {}

    def report(self, step: str, state: str, found: Iterable[Diagnostic], pictures: Iterable[Path] = ()) -> None:
        """Add a finished step with its diagnostics and its drawings, and write ``road.json``."""
        self._found[step] = tuple(found)
        listed = [item.as_dict() for item in self._found[step]]
        drawn = [path.relative_to(self._folder).as_posix() for path in pictures if path.is_file()]
        self._rows[step] = {"step": step, "state": state, "diagnostics": listed, "pictures": drawn}
        values = {"format": FORMAT, "version": VERSION, "take": self._take, "steps": self.as_list()}
        write_text(self._folder / ROAD_FILE, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)

    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Return the diagnostics of all steps without duplicates."""
        return merge(item for step in STEPS for item in self._found.get(step, ()))

    def as_list(self) -> list[dict[str, object]]:
        """Return the finished steps in order, as JSON values."""
        return [self._rows[step] for step in STEPS if step in self._rows]

    def lines(self) -> dict[str, str]:
        """Return a line of text for each finished step, by step name."""
        done = [step for step in STEPS if step in self._rows]
        return {step: f"{self._rows[step]['state']}: {' '.join(map(sentence, self._found[step]))}" for step in done}
