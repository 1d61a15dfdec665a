"""Read data set descriptions: all combinations of motions, people, camera arrays and looks."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.exchange.marker_formats import MARKER_FORMATS
from solver_backend.io.files import read_json
from solver_backend.synthesis.faults import (
    MEASURED_DETECTOR,
    OPTICAL_MARKERS,
    CameraFaults,
    DetectorFaults,
    Faults,
    MarkerFaults,
)
from solver_backend.synthesis.studio.camera_arrays import CameraRing, build_camera_array
from solver_backend.synthesis.studio.checked_values import CheckedValues, StudioInvalid
from solver_backend.synthesis.studio.motions import CHOREOGRAPHY
from solver_backend.types import JointSet

CLOTHES = ("bare", "suit", "shirt_trousers", "tee_shorts", "tee_trousers", "tunic_leggings", "random")
HAIR = ("none", "short", "long", "random")
LIGHT = ("day", "dim", "night", "random")


@dataclass(frozen=True)
class StudioLook:
    """Appearance of a shot. If a value is 'random', the shot's seed determines it."""

    name: str
    clothes: str = "suit"  # Key of ``CLOTHES``.
    hair: str = "random"  # Key of ``HAIR``.
    light: str = "day"  # Key of ``LIGHT``, for colour images. Infrared images have their own lights.
    furniture: int = 0  # Number of pieces of furniture around the person, which hide parts of the person.
    room: bool = True  # True for walls and a ceiling, False for a bare floor.


_PRESETS: dict[str, dict[str, Any]] = {  # Values of each look preset. Chosen by hand.
    "suit": {"clothes": "suit", "hair": "short"},
    "bare": {"clothes": "bare", "hair": "none"},
    "everyday": {"clothes": "random", "hair": "random", "furniture": 2},
    "cluttered": {"clothes": "random", "hair": "random", "furniture": 5},
    "night": {"clothes": "random", "hair": "random", "light": "night", "furniture": 2},
    "varied": {"clothes": "random", "hair": "random", "light": "random", "furniture": 3},
}


def read_look(description: Any) -> StudioLook:
    """Read a look from a preset name or an object, or raise ``StudioInvalid``."""
    values = CheckedValues.described(description, "look", StudioLook.__dataclass_fields__, _PRESETS)
    limits = {"clothes": CLOTHES, "hair": HAIR, "light": LIGHT, "furniture": (0, 20)}
    return values.fill(StudioLook, limits, name=values.text("name", "look"))


def draw_light(light: str, rng: np.random.Generator) -> str:
    """Return the given light, or a random light if it is 'random'."""
    drawn = str(rng.choice([name for name in LIGHT if name != "random"]))
    return drawn if light == "random" else light


_PERTURBATION_KEYS: dict[str, tuple[str, ...]] = {  # Path in ``Faults`` for each key. 0 disables a fault.
    "bias_mm": ("detector", "view_bias_mm"),
    **{
        name: ("detector", name)
        for name in ("drift_mm", "jitter_mm", "missing", "occluded_missing", "outliers", "swaps_per_minute")
    },
    "anatomy_mm": ("anatomy_mm",),
    **{name: ("cameras", name) for name in ("calibration_mm", "delay_frames")},
    "marker_mm": ("markers", "measurement_mm"),
    **{name: ("markers", name) for name in ("placement_mm", "skin_mm")},
    "marker_gaps": ("markers", "hidden"),
    "marker_views": ("markers", "least_views"),
    "marker_swaps_per_minute": ("markers", "swaps_per_minute"),
    "ghosts": ("markers", "ghosts"),
}
_LARGEST = {"missing": 0.9, "occluded_missing": 0.95, "outliers": 0.9, "marker_gaps": 0.9, "ghosts": 0.9}
_GOOD_DETECTOR = DetectorFaults(4.0, 6.0, jitter_mm=3.0, missing=0.002, occluded_missing=0.3, outliers=0.002)
_DEPTH_MARKERS = MarkerFaults(4.0, 8.0, 1.5, hidden=0.15, ghosts=0.01)
PRESETS: dict[str, Faults] = {
    "none": Faults(),
    "jitter": Faults(DetectorFaults(jitter_mm=5.0)),
    "detector": Faults(MEASURED_DETECTOR, 8.0, CameraFaults(8.0)),
    "good_detector": Faults(_GOOD_DETECTOR, 5.0, CameraFaults(2.0)),
    "optical_markers": Faults(markers=replace(OPTICAL_MARKERS, swaps_per_minute=1.0, ghosts=0.001)),
    "depth_markers": Faults(markers=_DEPTH_MARKERS),
}
"""Fault presets. 'detector' was measured, 'optical_markers' comes from the demo recording, and the others were chosen
by hand.
"""


def read_faults(description: Any) -> Faults:
    """Read simulated faults from a preset name or an object, which may extend a preset.

    Raises:
        StudioInvalid: a key or preset is unknown, or a value is invalid.
    """
    presets = {name: sizes_of(faults) for name, faults in PRESETS.items()}
    values, faults = CheckedValues.described(description, "perturb", _PERTURBATION_KEYS, presets), Faults()
    for key, (part, *rest) in _PERTURBATION_KEYS.items():
        value: Any = values.number(key, 0.0, 0.0, _LARGEST.get(key, 1000.0))
        faults = replace(faults, **{part: replace(getattr(faults, part), **{rest[0]: value}) if rest else value})
    return faults


def sizes_of(faults: Faults) -> dict[str, float]:
    """Return the size of each fault, by its key in data set descriptions."""
    parts = {"": faults, "detector": faults.detector, "cameras": faults.cameras, "markers": faults.markers}
    return {key: getattr(parts["".join(path[:-1])], path[-1]) for key, path in _PERTURBATION_KEYS.items()}


VERSION = 1
KINDS = ("infrared", "depth", "masks", "normals", "rgb")  # Types of images that can be rendered.
FORMATS = ("pose2sim", "coco", *MARKER_FORMATS, "video", "exr")  # Formats written in addition to our own capture.
_KEYS = (
    *["version", "name", "seed", "fps", "frames", "motions", "people", "camera_arrays", "looks"],
    *["film", "write", "markers", "joint_set", "perturb", "rgb", "hands"],
)
ENGINES = ("workbench", "cycles", "eevee")


@dataclass(frozen=True)
class People:
    """The simulated people in a data set."""

    count: int = 1
    sigma: float = 0.8  # Standard deviation of their shapes relative to the population's.
    strange: bool = False  # True gives them proportions outside the solver's shape space.


@dataclass(frozen=True)
class RgbSettings:
    """Settings of colour images, which Blender renders."""

    engine: str = "workbench"  # 'workbench' is fast. 'cycles' and 'eevee' simulate the lighting of the room.
    samples: int = 4  # Samples per pixel for 'cycles' and 'eevee'.
    blur: float = 0.0  # Exposure time as a fraction of the frame interval.
    exposure: float = 0.0  # Exposure change in stops. Each shot also gets a random change of up to half a stop.
    noise: float = 0.01  # Standard deviation of the sensor noise, relative to full scale.
    rolling_s: float = 0.0  # Seconds between the first and last row of a rolling shutter.


# The range of each number and the names of each choice.
_RGB_LIMITS = {"engine": ENGINES, "samples": (1, 4096), "blur": (0.0, 1.0), "exposure": (-8.0, 8.0)}
_RGB_LIMITS |= {"noise": (0.0, 1.0), "rolling_s": (0.0, 1.0)}


@dataclass(frozen=True)
class Spec:
    """The description of a data set."""

    name: str
    seed: int
    fps: float
    frames: int
    motions: tuple[str, ...]  # Files, folders, or the built-in choreography.
    people: People
    arrays: tuple[CameraRing, ...]
    looks: tuple[StudioLook, ...]
    film: tuple[str, ...]  # Elements of ``KINDS``.
    write: tuple[str, ...]  # Elements of ``FORMATS``.
    markers: str  # Marker layout that the person wears, or "" for none.
    joint_set: JointSet  # Joint set of the keypoints that are written and solved. The ground truth contains every set.
    perturb: Faults
    hands: bool  # True if the fingers move and captures contain hands.
    rgb: RgbSettings
    folder: Path  # Base of relative paths.
    text: str  # Description as plain JSON with sorted keys, which identifies the data set.


def read_spec(path: Path | str) -> Spec:
    """Read a data set description from a file. Raise FileMissing, FileDamaged or errors of ``spec_of``."""
    path = Path(path)
    return spec_of(read_json(path), path.resolve().parent)


def spec_of(values: Any, folder: Path = Path()) -> Spec:
    """Build a data set description from plain values.

    Raises:
        StudioInvalid: a key or preset is unknown, a type is wrong, or a value is invalid.
        MocapError: the capture that defines an array cannot be read.
    """
    top = CheckedValues(values, "description", _KEYS)
    if top.whole("version", VERSION, 0, 10**6) != VERSION:
        raise StudioInvalid(f"The version is {top.raw('version')}, but {VERSION} is needed.", where="version")
    layouts = sorted(load_layouts().layouts)
    markers = top.raw("markers", "MANIFOLD_53")
    markers = "" if markers is None else top.choice("markers", "MANIFOLD_53", layouts)
    arrays = tuple(build_camera_array(item, folder) for item in _several(top, "camera_arrays", ["azure_kinect_3"]))
    looks = tuple(read_look(item) for item in _several(top, "looks", ["suit"]))
    motions = top.raw("motions", [CHOREOGRAPHY])
    if not isinstance(motions, list) or not motions or not all(isinstance(m, str) and m for m in motions):
        raise StudioInvalid("motions must be a list of files, folders or 'choreography'.", where="description: motions")
    for what, names in (("camera_arrays", [r.name for r in arrays]), ("looks", [k.name for k in looks])):
        if len(set(names)) < len(names):
            raise StudioInvalid(f"Two {what} have the same name: {', '.join(names)}.", where=f"description: {what}")
    people = CheckedValues(top.raw("people", {}), "people", People.__dataclass_fields__)
    rgb = CheckedValues(top.raw("rgb", {}), "rgb", RgbSettings.__dataclass_fields__)
    size = top.whole("seed", 0, 0, 2**31), top.number("fps", 30.0, 1.0, 1000.0), top.whole("frames", 60, 1, 100_000)
    cast = tuple(motions), people.fill(People, {"count": (1, 100_000), "sigma": (0.0, 3.0)})
    film = top.choices("film", ("infrared", "depth", "masks"), KINDS), top.choices("write", (), FORMATS)
    joint_set = JointSet(top.choice("joint_set", "BODY_25", [s.value for s in JointSet]))
    perturb, hands = read_faults(top.raw("perturb", "none")), top.flag("hands", False)
    rest = perturb, hands, rgb.fill(RgbSettings, _RGB_LIMITS), folder, json.dumps(values, sort_keys=True)
    return _require_sense(
        Spec(top.text("name", "studio"), *size, *cast, arrays, looks, *film, markers, joint_set, *rest)
    )


def _require_sense(spec: Spec) -> Spec:
    needs_markers = MARKER_FORMATS.keys() & set(spec.write)
    if needs_markers and not spec.markers:
        raise StudioInvalid(
            f"{', '.join(sorted(needs_markers))} need markers, but the person wears none.",
            where="description: write",
            hint="Set a layout in 'markers', or omit these formats.",
        )
    if "video" in spec.write and "rgb" not in spec.film:
        raise StudioInvalid("Videos need colour images.", where="description: film", hint="Add 'rgb'.")
    if spec.hands and spec.people.strange:
        raise StudioInvalid("People with unusual proportions have no finger joints.", where="description: hands")
    alone = [array.name for array in spec.arrays if len(array.cameras) < 2]
    if "pose2sim" in spec.write and alone:
        raise StudioInvalid(
            f"A Pose2Sim trial needs at least two cameras, but {', '.join(alone)} has one.",
            where="description: write",
            hint="Omit 'pose2sim', or film with more cameras.",
        )
    # Marker centres are 9.5 mm above the skin, so loose clothes would cover them.
    loose = [look.name for look in spec.looks if look.clothes not in ("suit", "bare")]
    if spec.markers and loose and "markers" in json.loads(spec.text):
        raise StudioInvalid(
            f"Markers must be worn on skin or a suit, not under loose clothes ({', '.join(loose)}).",
            where="description: looks",
            hint="Set 'markers' to null, or 'clothes' to 'suit'.",
        )
    return replace(spec, markers="") if loose else spec


def _several(top: CheckedValues, key: str, default: list[Any]) -> list[Any]:
    items = top.raw(key, default)
    if not isinstance(items, list) or not items:
        raise StudioInvalid(f"{key} must be a list with at least one entry.", where=f"description: {key}")
    return items
