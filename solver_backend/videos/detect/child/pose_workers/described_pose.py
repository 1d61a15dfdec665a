"""Run a user's ONNX or LiteRT pose model that outputs heat maps, SimCC rows or coordinates.

It processes one person at a time, inside the box found in the previous image. ``DEFAULTS`` lists the description.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from .litert_pose import open_interpreter
from .onnx_pose import Outputs, Run, TopDown, open_model, simcc
from .serve import Refused, serve

REQUIRED = ("model", "joint_set", "size", "decoding")  # The size is the input's width and height in pixels.
DEFAULTS: dict[str, Any] = {
    "outputs": [],  # Names of the outputs to decode. By default the first ones.
    "channels": "RGB",
    "mean": [0.0, 0.0, 0.0],  # Mean level per channel, 0 to 255. The input is (level - mean) / std.
    "std": [255.0, 255.0, 255.0],
    "padding": 1.25,  # Size of the model's input box relative to the person's box.
    "udp": False,  # True if the centres of a heat map's corner cells lie on corner pixels (Huang et al. 2020).
    "columns": ["x", "y", "score"],  # Values per point in a coordinate output. All other names are ignored.
    "unit": "pixels",  # Coordinate unit: input pixels, or fractions of the input size.
    "score": "share",  # A number from 0 to 1, or a logit.
}
_CHOICES = {
    "decoding": ("heatmaps", "simcc", "coordinates"),
    "channels": ("RGB", "BGR"),
    "unit": ("pixels", "shares"),
    "score": ("share", "logit"),
    "udp": (False, True),
}
_SIZES = range(16, 4097)  # Allowed side lengths of an input, in pixels.
_LARGEST = 1e6  # Largest number allowed in a description. Chosen by hand.
HINT = "See docs/how-to/add-a-detector.md, which has a complete example."


def read_description(given: dict[str, Any]) -> dict[str, Any]:
    """Validate a model description and fill in its defaults. Raise ``Refused`` if a field is invalid."""
    unknown = sorted(set(given) - {*REQUIRED, *DEFAULTS})
    missing = [name for name in REQUIRED if name not in given]
    if unknown or missing:
        what = f"has no '{missing[0]}'" if missing else f"has an unknown field '{unknown[0]}'"
        raise _refused(f"The description {what}.")
    described = {**DEFAULTS, **given}
    for name, choices in _CHOICES.items():
        if described[name] not in choices:
            raise _refused(f"'{name}' is {described[name]!r} instead of one of {', '.join(map(str, choices))}.")
    if not _is_list(described["size"], int, 2) or not all(side in _SIZES for side in described["size"]):
        raise _refused(f"'size' is {described['size']!r} instead of a pixel width and height, such as [192, 256].")
    for name in ("mean", "std"):
        if not _is_list(described[name], (int, float), 3) or (name == "std" and min(described[name]) <= 0):
            raise _refused(f"'{name}' is {described[name]!r} instead of three numbers, one per channel.")
    if not isinstance(described["padding"], (int, float)) or not 1.0 <= described["padding"] <= 4.0:
        raise _refused(f"'padding' is {described['padding']!r} instead of a number from 1 to 4.")
    if not _is_list(described["columns"], str) or not {"x", "y"} <= set(described["columns"]):
        raise _refused(f"'columns' is {described['columns']!r} instead of a list of names with x and y.")
    if not _is_list(described["outputs"], str):
        raise _refused(f"'outputs' is {described['outputs']!r} instead of a list of names.")
    return described


def _is_list(value: Any, kind: Any, count: int = 0) -> bool:
    is_kind = isinstance(value, list) and all(isinstance(n, kind) and not isinstance(n, bool) for n in value)
    finite = is_kind and all(isinstance(n, str) or abs(n) < _LARGEST for n in value)
    return finite and (not count or len(value) == count)


def _refused(message: str) -> Refused:
    return Refused("detector_outputs_unknown", message, HINT)


def heat_peaks(heat: np.ndarray, size: tuple[int, int], *, udp: bool) -> np.ndarray:
    """Find the peak (x, y, score) of each of K heat maps (K, h, w) for an image of the given width and height.

    The peak is the vertex of the parabola through the logarithms of the maximum and its neighbours, which is exact for
    a Gaussian.

    Reference: Zhang et al. 2020 (DARK).
    """
    count, high, wide = heat.shape
    rows, columns = np.divmod(heat.reshape(count, -1).argmax(axis=1), wide)
    number, top = np.arange(count), heat.reshape(count, -1).max(axis=1)
    at = np.stack([columns, rows], axis=1).astype(np.float64)
    for axis, last in ((0, wide - 1), (1, high - 1)):
        step = np.array([(0, 1), (1, 0)][axis])
        inside = (at[:, axis] > 0) & (at[:, axis] < last) & (top > 0)
        r, c, n = rows[inside], columns[inside], number[inside]
        before, here, after = (
            np.log(np.maximum(heat[n, r + k * step[0], c + k * step[1]], 1e-6 * top[n])) for k in (-1, 0, 1)
        )
        bend = np.minimum(before - 2.0 * here + after, -1e-9)
        at[inside, axis] += np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    cells = np.array([wide, high], np.float64)
    at *= (np.array(size) - 1.0) / (cells - 1.0) if udp else np.array(size) / cells
    return np.concatenate([at, top[:, None]], axis=1)


class DescribedPose(TopDown):
    """Detects people with a pose model that a user's JSON file describes."""

    def __init__(self, options: dict[str, Any]) -> None:
        described, path = read_description(options["description"]), Path(options["model"])
        self._counts = [int(count) for count in options["counts"]]  # Possible numbers of points in the joint set.
        opened = _onnx(path) if path.suffix.lower() == ".onnx" else _litert(path)
        shape, kind, outputs, run = opened
        self.described, self.size, self.padding = described, tuple(described["size"]), float(described["padding"])
        names = [name for name, _ in outputs]
        missing = [name for name in described["outputs"] if name not in names]
        needed = 2 if described["decoding"] == "simcc" else 1
        self.chosen = [names.index(name) for name in described["outputs"] if name in names] or list(range(needed))
        if missing or len(self.chosen) != needed or max(self.chosen) >= len(outputs):
            raise _refused(f"{described['decoding']} need {needed} of the model's outputs: {outputs}.")
        people = int(options.get("people", 1))
        super().__init__(shape, kind, outputs, run, people)
        try:
            self.num_keypoints = len(self.points(np.full((*self.size[::-1], 3), 127.0, np.float32)))
        except Exception as error:  # both libraries raise their own exception types
            message = f"The model's input {shape} and outputs {outputs} do not match the description: "
            raise _refused(message + str(error).splitlines()[0]) from error
        self.about = {"name": f"described {path.stem}", "joint_set": described["joint_set"], "people": people}

    def points(self, picture: np.ndarray) -> np.ndarray:
        """Detect keypoints (K, 3) in an (h, w, 3) image of the model's input size, with levels from 0 to 255."""
        told = self.described
        levels = picture[..., ::-1] if told["channels"] == "BGR" else picture
        found = self.run(self.tensor((levels - np.array(told["mean"])) / np.array(told["std"])))
        arrays = [np.asarray(found[i], np.float64)[0] for i in self.chosen]
        if told["decoding"] == "simcc":
            points = simcc(arrays[0], arrays[1], self.size[0])
        elif told["decoding"] == "heatmaps":
            heat = arrays[0] if arrays[0].shape[0] in self._counts else arrays[0].transpose(2, 0, 1)
            points = heat_peaks(heat, self.size, udp=told["udp"])
        else:
            columns = told["columns"]
            if arrays[0].shape[-1] not in (len(columns), arrays[0].size):
                raise ValueError(f"an output of {len(columns)} columns has the shape {arrays[0].shape}")
            rows = arrays[0].reshape(-1, len(columns))
            points = np.ones((len(rows), 3))
            for i, name in enumerate(("x", "y", "score")):
                if name in columns:
                    points[:, i] = rows[:, columns.index(name)]
            points[:, :2] *= np.array(self.size) if told["unit"] == "shares" else 1.0
        if len(points) not in self._counts:
            raise ValueError(f"{len(points)} points, but the joint set has {' or '.join(map(str, self._counts))}")
        if told["score"] == "logit":
            points[:, 2] = 1.0 / (1.0 + np.exp(-np.clip(points[:, 2], -60.0, 60.0)))
        points[:, 2] = np.clip(points[:, 2], 0.0, 1.0)
        return points

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Detect the keypoints of all people (see ``PoseDetector``)."""
        return {"keypoints": self.people(rgb)}


Opened = tuple[list[Any], str, Outputs, Run]  # Input shape and type, outputs, and the function that runs the model.


def _onnx(path: Path) -> Opened:
    session = open_model(str(path))
    given, outputs = session.get_inputs()[0], session.get_outputs()
    told = [(o.name, list(o.shape)) for o in outputs]
    return list(given.shape), given.type, told, lambda tensor: session.run(None, {given.name: tensor})


def _litert(path: Path) -> Opened:
    model = open_interpreter(path.read_bytes())
    given, outputs = model.get_input_details()[0], model.get_output_details()

    def run(tensor: np.ndarray) -> list[np.ndarray]:
        model.set_tensor(given["index"], tensor)
        model.invoke()
        return [model.get_tensor(output["index"]) for output in outputs]

    told = [(str(o["name"]), o["shape"].tolist()) for o in outputs]
    return given["shape"].tolist(), f"tensor({np.dtype(given['dtype']).name})", told, run


if __name__ == "__main__":
    sys.exit(serve(DescribedPose))
