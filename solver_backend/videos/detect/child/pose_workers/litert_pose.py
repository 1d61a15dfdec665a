"""Run MediaPipe's pose and hand models with Google's LiteRT."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import Any

import numpy as np

from .crops import SquareCrop, direction, overlap
from .serve import THREADS, Refused, serve


def open_interpreter(content: bytes) -> Any:
    """Create a LiteRT interpreter for the bytes of a model. Raise ``Refused`` if that fails."""
    try:
        from ai_edge_litert.interpreter import Interpreter
    except ImportError as error:
        message = f"The ai-edge-litert package is missing: {error} ({sys.executable})"
        hint = "Run `pip install ai-edge-litert numpy` in a separate environment, and specify its Python with --python."
        raise Refused("detector_missing", message, hint) from error
    try:
        model = Interpreter(model_content=content, num_threads=THREADS)
        model.allocate_tensors()
    except (ValueError, RuntimeError) as error:
        message = f"The model cannot be loaded: {str(error).splitlines()[0]}"
        raise Refused("detector_missing", message, "Download it again.") from error
    return model


LICENCE = "Apache-2.0"  # Licence of all known models.


class LiteRtModel:
    """A MediaPipe model with a single input tensor. Only models with a known SHA-256 hash are accepted."""

    def __init__(self, path: Path, known: dict[str, str], package: str, widths: list[int]) -> None:
        """Load a model, and check the number of elements in its first outputs against ``widths``."""
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        if digest not in known:
            message = f"The SHA-256 of {path.name} is {digest}, which is not one of {', '.join(known.values())}."
            raise Refused("detector_outputs_unknown", message, f"Extract it from the npm package {package}.")
        self.name = known[digest]
        self._model = open_interpreter(content)
        self._into = self._model.get_input_details()[0]["index"]
        outputs = self._model.get_output_details()
        self._out = [output["index"] for output in outputs]
        found = [int(np.prod(output["shape"])) for output in outputs]
        if found[: len(widths)] != widths:
            message = f"The outputs of {self.name} have {found} numbers, but the first ones must have {widths}."
            raise Refused("detector_outputs_unknown", message)

    def run(self, picture: np.ndarray) -> list[np.ndarray]:
        """Run the model on an (h, w, 3) image in its input size and value range. Return the outputs."""
        self._model.set_tensor(self._into, np.ascontiguousarray(picture[None], np.float32))
        self._model.invoke()
        return [np.asarray(self._model.get_tensor(index))[0] for index in self._out]


DETECTOR_SIDE = 224  # Side of the person detector's input in pixels.
_GRIDS = ((28, 2), (14, 2), (7, 6))  # Cells per side of each grid of anchors, and anchors per cell.
NUM_ANCHORS = sum(cells * cells * anchors for cells, anchors in _GRIDS)
NUM_NUMBERS = 12  # Numbers per box: centre, size, four points. The first two are the hips and the top of the circle.
_LIKELY = 0.5  # Smallest anchor score at which a person is detected.
_SAME_BOX = 0.3  # Smallest overlap (intersection over union) between two boxes of the same person.
_GROWN = 1.25  # Side length of the square in circle diameters.


def whole_picture(rgb: np.ndarray) -> SquareCrop:
    """Return the square around the whole image, for the person detector."""
    middle = 0.5 * np.array(rgb.shape[1::-1], np.float64)
    return _square(middle, np.array([0.0, -1.0]), float(max(rgb.shape[:2])), DETECTOR_SIDE)


def aligned(hips: np.ndarray, top: np.ndarray, side: int) -> SquareCrop:
    """Return the square around a person's hips (2,) px, rotated so that ``top`` (2,) is above the hips."""
    up, radius = direction(hips, top, 1e-6)
    return _square(hips, up, _GROWN * 2.0 * max(radius, 4.0), side)


def _square(middle: np.ndarray, up: np.ndarray, length: float, side: int) -> SquareCrop:
    return SquareCrop.around(middle, up, length, side, 0.5 * side)


def found_people(boxes: np.ndarray, scores: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Decode detected people: hips and top (2,) in the detector's pixels, most likely person first.

    The points of overlapping boxes are averaged, weighted by score.

    Args:
        boxes: (NUM_ANCHORS, 12) model outputs.
        scores: (NUM_ANCHORS,) scores before the logistic function is applied.
    """
    score = 1.0 / (1.0 + np.exp(-np.clip(scores, -100.0, 100.0)))
    likely = np.flatnonzero(score >= _LIKELY)
    likely = likely[np.argsort(-score[likely], kind="stable")]
    numbers = boxes[likely].reshape(-1, NUM_NUMBERS // 2, 2).astype(np.float64)
    places = DETECTOR_SIDE * _ANCHORS[likely, None] + numbers
    corners = np.hstack([places[:, 0] - 0.5 * numbers[:, 1], places[:, 0] + 0.5 * numbers[:, 1]])
    people, left = [], np.ones(len(likely), bool)
    for k in range(len(likely)):
        if left[k]:
            same = left & (overlap(corners[k], corners) > _SAME_BOX)
            same[k] = True
            left &= ~same
            weight = score[likely[same], None, None]
            hips, top = (weight * places[same, 2:4]).sum(axis=0) / weight.sum()
            people.append((hips, top))
    return people


def _anchors(cells: int, anchors: int) -> np.ndarray:
    middles = np.indices((cells, cells))[::-1].reshape(2, -1).T + 0.5
    return np.repeat(middles / cells, anchors, axis=0)


_ANCHORS = np.concatenate([_anchors(*grid) for grid in _GRIDS])  # (NUM_ANCHORS, 2) centres relative to the input size.
DETECTORS = {
    "a63c614bef30d35947f13be361820b1e4e3bec9cfeebf4d11216a18373108e85": "pose_detection",
    "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c": "pose_detection",
}
LANDMARKS = {
    "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f": "pose_landmark_full",
    "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe": "pose_landmark_heavy",
    "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61": "pose_landmark_lite",
}
"""SHA-256 hashes of the known models. Files from npm and from MediaPipe's wheel may differ only in metadata."""
DETECTOR_FILE = "pose_solution_packed_assets.data"  # Person detector. It lies in the folder of the landmark models.
PACKAGE = "@mediapipe/pose 0.5.1675469404"
SIDE = 256  # Side length of the landmark model's input in pixels.
NUM_POINTS, _ALL_POINTS, _NUMBERS = 33, 39, 5
_HIPS, _TOP = 33, 34  # Points that determine the square in the next image.
_HEAT, _WINDOW = 64, 3  # Cells per side of a heat map, and radius in cells of the averaging window around a point.
_PRESENT, _SURE = 0.5, 0.5  # Smallest probability that a square contains a person, and smallest averaged heat.
_SAME = 0.2  # Largest mean distance between two detections of the same person's points, relative to the square's side.


class LiteRtPose:
    """Detects people and their keypoints (Bazarevsky et al. 2020, BlazePose).

    The person detector searches the whole image until all requested people are found. The landmark model processes a
    square around each person. Two landmarks of a person determine this person's square in the next image.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        path = Path(options["model"])
        beside = path.with_name(DETECTOR_FILE)
        if not beside.is_file():
            message = f"The person detector {DETECTOR_FILE} is not in the folder of {path.name}."
            hint = f"Keep the model in the folder that npm pack {PACKAGE.replace(' ', '@')} and tar create."
            raise Refused("detector_missing", message, hint)
        widths = [_ALL_POINTS * _NUMBERS, 1, SIDE * SIDE, _HEAT * _HEAT * _ALL_POINTS]
        self._landmarks = LiteRtModel(path, LANDMARKS, PACKAGE, widths)
        self._detector = LiteRtModel(beside, DETECTORS, PACKAGE, [NUM_ANCHORS * NUM_NUMBERS, NUM_ANCHORS])
        self._people = int(options.get("people", 1))
        self._squares: list[SquareCrop] = []
        name = self._landmarks.name.replace("_landmark_", " ")
        self.about = {"name": f"litert {name}", "licence": LICENCE, "joint_set": "MEDIAPIPE_33", "people": self._people}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Detect the keypoints of all people (see ``PoseDetector``)."""
        people: list[np.ndarray] = []
        squares, self._squares = self._squares, []
        for square in squares:
            self._look(rgb, square, people)
        if len(people) < self._people:
            whole = whole_picture(rgb)
            boxes, scores, *_ = self._detector.run(2.0 * (whole.cut(rgb, DETECTOR_SIDE, 0.5) / np.float32(255.0)) - 1.0)
            for hips, top in found_people(boxes, scores[:, 0]):
                if len(people) < self._people:
                    self._look(rgb, aligned(*whole.in_picture(np.stack([hips, top])), side=SIDE), people)
        return {"keypoints": np.stack(people) if people else np.zeros((0, NUM_POINTS, 3))}

    def _look(self, rgb: np.ndarray, square: SquareCrop, people: list[np.ndarray]) -> None:
        """Detect the person in a square. Add a new person to ``people``, and store the square for the next image."""
        points, presence, _, heat, *_ = self._landmarks.run(square.cut(rgb, SIDE, None) / np.float32(255.0))
        if float(presence[0]) < _PRESENT:
            return
        numbers = points.reshape(_ALL_POINTS, _NUMBERS).astype(np.float64)
        places = square.in_picture(refined(numbers[:, :2], heat))
        length = SIDE * float(np.hypot(*square.A[:, 0]))
        own = places[:NUM_POINTS]
        if any(np.linalg.norm(own - other[:, :2], axis=1).mean() < _SAME * length for other in people):
            return
        inside = ((own >= 0) & (own <= rgb.shape[1::-1])).all(axis=1)
        seen = inside / (1.0 + np.exp(-numbers[:NUM_POINTS, 3]))
        people.append(np.column_stack([own - 0.5, seen]))
        self._squares.append(aligned(places[_HIPS], places[_TOP], SIDE))


def refined(points: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """Move points (39, 2) to the centroid of their heat maps (64, 64, 39) where the heat is high enough."""
    cell = np.floor(points * (_HEAT / SIDE)).astype(int)
    around = np.arange(-_WINDOW, _WINDOW + 1)
    columns, rows = cell[:, :1] + around, cell[:, 1:] + around
    inside = ((rows >= 0) & (rows < _HEAT))[:, :, None] & ((columns >= 0) & (columns < _HEAT))[:, None]
    number = np.arange(len(points))[:, None, None]
    logits = heat[rows.clip(0, _HEAT - 1)[:, :, None], columns.clip(0, _HEAT - 1)[:, None], number]
    h = inside / (1.0 + np.exp(-logits.astype(np.float64)))
    total = np.maximum(h.sum(axis=(1, 2)), 1e-12)
    mean = np.stack([(h * columns[:, None]).sum(axis=(1, 2)), (h * rows[:, :, None]).sum(axis=(1, 2))], axis=1)
    sure = (h.max(axis=(1, 2)) >= _SURE) & ((cell >= 0) & (cell < _HEAT)).all(axis=1)
    return np.where(sure[:, None], mean / total[:, None] * (SIDE / _HEAT), points)


HANDS = {
    "8c026882c9ec059ce0f8e75266bee5a9a23c341a40e0000df755374d3d1b9b68": "hand_landmark_full",
    "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3": "hand_landmark_full",
    "d7fde8ac11f8ce03f8663775bfc323f4fc9f2a38062b4f4efa142874ef5b2a48": "hand_landmark_lite",
}
HANDS_PACKAGE = "@mediapipe/hands 0.4.1675469240"


class LiteRtHands:
    """Detects the 21 points of one hand in a crop."""

    def __init__(self, options: dict[str, Any]) -> None:
        self._model = LiteRtModel(Path(options["model"]), HANDS, HANDS_PACKAGE, [63, 1, 1])
        self.about = {"name": self._model.name, "licence": LICENCE, "num_keypoints": 21, "people": 1}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Detect ``points`` (21, 2) in a (224, 224, 3) crop, with the probabilities of a hand and of a right hand."""
        points, presence, right, *_ = self._model.run(rgb.astype(np.float32) / 255.0)
        return {"points": points.reshape(21, 3)[:, :2], "presence": presence.reshape(1), "right": right.reshape(1)}


if __name__ == "__main__":
    sys.exit(serve(lambda options: LiteRtHands(options) if options.get("one_hand") else LiteRtPose(options)))
