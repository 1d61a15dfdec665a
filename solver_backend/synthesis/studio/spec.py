"""The description of a data set: motions x people x arrays x looks, what is filmed and what is written."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.exchange.marker_formats import MARKER_FORMATS
from solver_backend.io.files import read_json
from solver_backend.synthesis.faults import Faults
from solver_backend.synthesis.studio.camera_arrays import CameraRing, build_camera_array
from solver_backend.synthesis.studio.checked_values import CheckedValues
from solver_backend.synthesis.studio.errors import StudioInvalid
from solver_backend.synthesis.studio.looks import StudioLook, read_look
from solver_backend.synthesis.studio.motions import CHOREOGRAPHY
from solver_backend.synthesis.studio.perturbation import PRESETS, read_faults
from solver_backend.types import JointSet

VERSION = 1
KINDS = ("infrared", "depth", "masks", "normals", "rgb")
"""What can be filmed."""
FORMATS = ("pose2sim", "coco", *MARKER_FORMATS, "video", "exr")
"""What can be written beside our own capture."""
_KEYS = (
    "version", "name", "seed", "fps", "frames", "motions", "people", "camera_arrays", "looks", "film", "write",
    "markers", "joint_set", "perturb", "rgb", "hands",
)  # fmt: skip
ENGINES = ("workbench", "cycles", "eevee")


@dataclass(frozen=True)
class People:
    """Who is filmed."""

    count: int = 1
    """How many are drawn."""
    sigma: float = 0.8
    """Spread of their shapes, in standard deviations of the population."""
    strange: bool = False
    """Give them bones and flesh that no shape of the solver's body has."""


@dataclass(frozen=True)
class RgbSettings:
    """How colour pictures are made; the backend carries these to Blender."""

    engine: str = "workbench"
    """'workbench' is fast, 'cycles' and 'eevee' light the room."""
    samples: int = 4
    """Samples a pixel of 'cycles' and 'eevee'."""
    blur: float = 0.0
    """Share of a frame that the shutter is open."""
    exposure: float = 0.0
    """Stops brighter or darker; every shot draws half a stop more or less."""
    noise: float = 0.01
    """Standard deviation of the sensor's noise, of full scale."""
    rolling_s: float = 0.0
    """Seconds that the shutter takes from the first row to the last."""


@dataclass(frozen=True)
class Spec:
    """A whole data set."""

    name: str
    seed: int
    fps: float
    frames: int
    """Of a shot, at most."""
    motions: tuple[str, ...]
    """Files, folders, or the choreography that ships."""
    people: People
    arrays: tuple[CameraRing, ...]
    looks: tuple[StudioLook, ...]
    film: tuple[str, ...]
    """Some of ``KINDS``."""
    write: tuple[str, ...]
    """Some of ``FORMATS``."""
    markers: str
    """Layout that the person wears, "" for none."""
    joint_set: JointSet
    """Of the keypoints that are written and solved; the truth holds every set."""
    perturb: Faults
    hands: bool
    """Whether fingers move, and captures hold hands."""
    rgb: RgbSettings
    folder: Path
    """What paths are relative to."""
    text: str
    """The description as plain JSON with sorted keys: what makes a data set the same."""


def read_spec(path: Path | str) -> Spec:
    """Read a description.

    Raises:
        FileMissing: it is not there.
        FileDamaged: it is not JSON.
        StudioInvalid: see ``spec_of``.
    """
    path = Path(path)
    return spec_of(read_json(path), path.resolve().parent)


def spec_of(values: Any, folder: Path = Path()) -> Spec:
    """Return a description from plain values.

    Raises:
        StudioInvalid: a key or preset is unknown, a type is wrong, or a value is impossible.
        MocapError: the capture of an array cannot be read.
    """
    if isinstance(values, Mapping) and "rigs" in values and "camera_arrays" not in values:  # its name until 0.1
        values = {"camera_arrays": values["rigs"], **{key: value for key, value in values.items() if key != "rigs"}}
    top = CheckedValues(values, "description", _KEYS)
    if top.whole("version", VERSION, 0, 10**6) != VERSION:
        raise StudioInvalid(f"The description is of version {top.raw('version')}; {VERSION} is read.", where="version")
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
    spec = Spec(
        name=top.text("name", "studio"), seed=top.whole("seed", 0, 0, 2**31), fps=top.number("fps", 30.0, 1.0, 1000.0),
        frames=top.whole("frames", 60, 1, 100_000), motions=tuple(motions), people=_people(top), arrays=arrays,
        looks=looks, film=top.choices("film", ("infrared", "depth", "masks"), KINDS),
        write=top.choices("write", (), FORMATS), markers=markers,
        joint_set=JointSet(top.choice("joint_set", "BODY_25", [s.value for s in JointSet])),
        perturb=read_faults(top.raw("perturb", "none")), hands=top.flag("hands", False), rgb=_rgb(top), folder=folder,
        text=json.dumps(values, sort_keys=True),
    )  # fmt: skip
    return _require_sense(spec)


def _require_sense(spec: Spec) -> Spec:
    needs_markers = MARKER_FORMATS.keys() & set(spec.write)
    if needs_markers and not spec.markers:
        raise StudioInvalid(
            f"{', '.join(sorted(needs_markers))} hold markers, but the person wears none.", where="description: write",
            hint="Name a layout in 'markers', or leave these formats out.",
        )  # fmt: skip
    if "video" in spec.write and "rgb" not in spec.film:
        raise StudioInvalid("Videos are made of colour pictures.", where="description: film", hint="Add 'rgb'.")
    if spec.hands and spec.people.strange:
        raise StudioInvalid("People of unusual proportions have no finger joints.", where="description: hands")
    alone = [array.name for array in spec.arrays if len(array.cameras) < 2]
    if "pose2sim" in spec.write and alone:
        raise StudioInvalid(
            f"A trial of Pose2Sim has two cameras at least, {', '.join(alone)} has one.", where="description: write",
            hint="Leave out 'pose2sim', or film with more cameras.",
        )  # fmt: skip
    # A marker's centre lies 9.5 mm off the skin: loose clothes would swallow it.
    loose = [look.name for look in spec.looks if look.clothes not in ("suit", "bare")]
    if spec.markers and loose and "markers" in json.loads(spec.text):
        raise StudioInvalid(
            f"Markers are worn on skin or a suit, not under loose clothes ({', '.join(loose)}).",
            where="description: looks", hint="Set 'markers' to null, or 'clothes' to 'suit'.",
        )  # fmt: skip
    return replace(spec, markers="") if loose else spec


def _several(top: CheckedValues, key: str, default: list[Any]) -> list[Any]:
    items = top.raw(key, default)
    if not isinstance(items, list) or not items:
        raise StudioInvalid(f"{key} must be a list of at least one.", where=f"description: {key}")
    return items


def _people(top: CheckedValues) -> People:
    values = CheckedValues(top.raw("people", {}), "people", ("count", "sigma", "strange"))
    return People(
        values.whole("count", 1, 1, 100_000), values.number("sigma", 0.8, 0.0, 3.0), values.flag("strange", False)
    )


def _rgb(top: CheckedValues) -> RgbSettings:
    values = CheckedValues(top.raw("rgb", {}), "rgb", RgbSettings.__dataclass_fields__)
    return RgbSettings(
        values.choice("engine", "workbench", ENGINES), values.whole("samples", 4, 1, 4096),
        values.number("blur", 0.0, 0.0, 1.0), values.number("exposure", 0.0, -8.0, 8.0),
        values.number("noise", 0.01, 0.0, 1.0), values.number("rolling_s", 0.0, 0.0, 1.0),
    )  # fmt: skip


__all__ = ["ENGINES", "FORMATS", "KINDS", "PRESETS", "People", "RgbSettings", "Spec", "read_spec", "spec_of"]
