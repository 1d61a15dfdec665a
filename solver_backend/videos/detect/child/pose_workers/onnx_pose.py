"""Run ONNX pose models. Their inputs and outputs identify the type of model."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from .crops import overlap
from .serve import THREADS, Refused, serve

PADDING = 114.0  # Grey value used outside the image, 0 to 255.


def crop(rgb: np.ndarray, low: np.ndarray, high: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resample the box from corner ``low`` to corner ``high`` to an (h, w, 3) float32 image, black outside the image.

    Column j shows ``x = low + (high - low) j / w``, because models are trained with a box corner at the first pixel.
    """
    width, height = size
    x = low[0] + (high[0] - low[0]) * np.arange(width) / width
    y = low[1] + (high[1] - low[1]) * np.arange(height) / height
    return sampled(rgb, x, y, 0.0)


def letterbox(rgb: np.ndarray, size: tuple[int, int], *, corner: bool) -> tuple[np.ndarray, float]:
    """Scale an image to fit into a grey image of the given width and height. Also return the scale s.

    The scaled image is at the top left corner if ``corner`` is True, so that pixel x becomes x' with
    ``x' + 1/2 = s (x + 1/2)``. Otherwise, it is centred.
    """
    width, height = size
    scale = min(width / rgb.shape[1], height / rgb.shape[0])
    used = [round(n * scale) for n in (rgb.shape[1], rgb.shape[0])]
    start = (0.0, 0.0) if corner else (0.5 * (width - used[0]), 0.5 * (height - used[1]))
    x = (np.arange(width) - start[0] + 0.5) / scale - 0.5
    y = (np.arange(height) - start[1] + 0.5) / scale - 0.5
    return sampled(rgb, x, y, PADDING), scale


def sampled(rgb: np.ndarray, x: np.ndarray, y: np.ndarray, outside: float) -> np.ndarray:
    """Resample an image at columns x and rows y by bilinear interpolation. Return (len(y), len(x), 3) float32."""
    rows, row_share, row_out = _neighbours(y, rgb.shape[0])
    columns, column_share, column_out = _neighbours(x, rgb.shape[1])
    by_row = rgb[rows].astype(np.float32)
    by_row += row_share[:, None, None] * (rgb[np.minimum(rows + 1, rgb.shape[0] - 1)] - by_row)
    left, right = by_row[:, columns], by_row[:, np.minimum(columns + 1, rgb.shape[1] - 1)]
    picture = left + column_share[:, None] * (right - left)
    picture[row_out], picture[:, column_out] = outside, outside
    return picture


def _neighbours(at: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    outside = (at < -0.5) | (at > count - 0.5)
    inside = np.clip(at, 0.0, count - 1.0)
    low = np.minimum(np.floor(inside).astype(int), count - 1)
    return low, (inside - low).astype(np.float32), outside


Outputs = list[tuple[str, list[Any]]]
Run = Callable[[np.ndarray], list[np.ndarray]]
LEAST_SCORE = 0.3  # Smallest confidence at which a person is detected.
LARGEST_OVERLAP = 0.65  # Largest overlap (intersection over union) between the boxes of two people.
_MEAN, _STD = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])
"""Mean and standard deviation of the ImageNet images (RGB, 0 to 255) on which RTMPose is trained."""


class _PoseModel:
    """Base class of the model types. ``people`` returns keypoints (P, K, 3): x, y and confidence."""

    label = ""

    def __init__(self, given: list[Any], kind: str, outputs: Outputs, run: Run, most: int) -> None:
        self.given, self.type, self.outputs, self.run, self.most = given, kind, outputs, run, most
        self.num_keypoints = 0
        self._prepare()

    def _prepare(self) -> None:
        raise NotImplementedError

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        raise NotImplementedError

    def people(self, rgb: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def tensor(self, picture: np.ndarray) -> np.ndarray:
        """Convert an image (h, w, 3) to the model's data type and channel order."""
        value = picture[None] if self.given[-1] == 3 else picture.transpose(2, 0, 1)[None]
        kind = {"tensor(int32)": np.int32, "tensor(uint8)": np.uint8, "tensor(float16)": np.float16}
        return np.ascontiguousarray(value.astype(kind.get(self.type, np.float32)))


class TopDown(_PoseModel):
    """Base class of models that process one person at a time, inside the box from the previous image."""

    size: tuple[int, int] = (0, 0)  # Width and height of the input in pixels.
    padding = 1.25  # Factor by which a person's box is enlarged.

    def points(self, picture: np.ndarray) -> np.ndarray:
        """Detect keypoints (K, 3) in an (h, w, 3) image of the model's input size, with levels from 0 to 255."""
        raise NotImplementedError

    def people(self, rgb: np.ndarray) -> np.ndarray:
        """Detect people in the boxes from the previous image. If they contain no person, search the whole image."""
        sure = self._sure(rgb, self.boxes)
        if not sure:  # first the whole image, then the box of the person found in it
            first = self._sure(rgb, [np.array([0.0, 0.0, rgb.shape[1], rgb.shape[0]])])
            sure = self._sure(rgb, list(map(_box, first)))
        kept = suppressed(np.array(list(map(_box, sure))), np.array([p[:, 2].mean() for p in sure]), self.most)
        sure = [sure[i] for i in kept]
        self.boxes = list(map(_box, sure))
        return np.stack(sure) if sure else np.zeros((0, self.num_keypoints, 3))

    def _prepare(self) -> None:
        self.boxes: list[np.ndarray] = []

    def _sure(self, rgb: np.ndarray, boxes: list[np.ndarray]) -> list[np.ndarray]:
        found = (self._in_box(rgb, box) for box in boxes)
        return [person for person in found if float(np.median(person[:, 2])) >= LEAST_SCORE]

    def _in_box(self, rgb: np.ndarray, box: np.ndarray) -> np.ndarray:
        width, height = self.size
        centre, span = 0.5 * (box[:2] + box[2:]), np.maximum(box[2:] - box[:2], 1.0) * self.padding
        span = np.maximum(span, span[::-1] * [width / height, height / width])
        low = centre - 0.5 * span
        found = self.points(crop(rgb, low, low + span, (width, height)))
        return np.concatenate([low + found[:, :2] * span / (width, height), found[:, 2:]], axis=1)


def simcc(x: np.ndarray, y: np.ndarray, width: int) -> np.ndarray:
    """Decode x, y and score of keypoints (K, 3) from one row of scores per axis.

    Reference: Li et al. 2022 (SimCC).
    """
    at = np.stack([x.argmax(axis=1), y.argmax(axis=1)], axis=1) / (x.shape[1] / width)
    score = np.minimum(x.max(axis=1), y.max(axis=1))
    return np.concatenate([at, score[:, None]], axis=1)


class _RtmPose(TopDown):
    """Top-down model that outputs one row of scores per axis (SimCC).

    Reference: Jiang et al. 2023 (RTMPose).
    """

    label = "RTMPose"

    def _prepare(self) -> None:
        super()._prepare()
        self.size = (int(self.given[3]), int(self.given[2]))
        self.num_keypoints = int(self.outputs[0][1][1])

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        """Return whether the input is (N, 3, H, W) and the outputs are (N, K, r W) and (N, K, r H) for an integer r."""
        if len(outputs) != 2 or len(given) != 4 or given[1] != 3 or not _numbers(given[2:]):
            return False
        (_, x), (_, y) = outputs
        if len(x) != 3 or len(y) != 3 or not _numbers([*x[1:], *y[1:]]) or x[1] != y[1]:
            return False
        return x[2] % given[3] == 0 and x[2] // given[3] == y[2] / given[2]

    def points(self, picture: np.ndarray) -> np.ndarray:
        x, y = (np.asarray(a, np.float64)[0] for a in self.run(self.tensor((picture - _MEAN) / _STD)))
        points = simcc(x, y, self.size[0])
        points[:, 2] = np.clip(points[:, 2], 0.0, 1.0)
        return points


class _Rtmo(_PoseModel):
    """One-stage model (Lu et al. 2024) that outputs boxes (N, P, 5) and keypoints (N, P, K, 3)."""

    label = "RTMO"

    def _prepare(self) -> None:
        self.points = next(i for i, (_, shape) in enumerate(self.outputs) if len(shape) == 4)
        self.num_keypoints = int(self.outputs[self.points][1][2])

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        by_rank = {len(shape): shape for _, shape in outputs}
        if len(outputs) != 2 or set(by_rank) != {3, 4} or given[1] != 3 or not _numbers(given[2:]):
            return False
        return by_rank[3][2] == 5 and by_rank[4][3] == 3 and _numbers(by_rank[4][2:])

    def people(self, rgb: np.ndarray) -> np.ndarray:
        picture, scale = letterbox(rgb[..., ::-1], (int(self.given[3]), int(self.given[2])), corner=True)
        both = self.run(self.tensor(picture))
        boxes, points = np.asarray(both[1 - self.points])[0], np.asarray(both[self.points], np.float64)[0]
        return _chosen(boxes[:, :4], boxes[:, 4], points, (0.0, 0.0), scale, self.most)


class _YoloPose(_PoseModel):
    """One-stage model that outputs N candidates as (1, 5 + 3 K, N): box centre and size, score, K keypoints.

    Models that include non-maximum suppression output (1, N, 6 + 3 K) with box corners, score and class.

    Reference: Maji et al. 2022, Ultralytics (output layout).
    """

    label = "YOLO-pose"

    def _prepare(self) -> None:
        shape = self.outputs[0][1]
        self.finished = _is_whole(shape[2], 6)
        self.num_keypoints = (shape[2] - 6) // 3 if self.finished else (shape[1] - 5) // 3

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        if len(outputs) != 1 or len(given) != 4 or given[1] != 3 or not _numbers(given[2:]):
            return False
        shape = outputs[0][1]
        return len(shape) == 3 and (_is_whole(shape[2], 6) or _is_whole(shape[1], 5))

    def people(self, rgb: np.ndarray) -> np.ndarray:
        size = int(self.given[3]), int(self.given[2])
        picture, scale = letterbox(rgb, size, corner=False)
        offset = 0.5 * (np.array(size) - np.round(np.array(rgb.shape[1::-1]) * scale))
        rows = np.asarray(self.run(self.tensor(picture / 255.0))[0], np.float64)[0]
        if self.finished:
            corners, score, points = rows[:, :4], rows[:, 4], rows[:, 6:]
        else:
            rows = rows.T
            half = 0.5 * rows[:, 2:4]
            corners = np.concatenate([rows[:, :2] - half, rows[:, :2] + half], axis=1)
            score, points = rows[:, 4], rows[:, 5:]
        return _chosen(corners, score, points.reshape(len(rows), -1, 3), offset, scale, self.most)


class _MoveNet(_PoseModel):
    """Model that outputs 17 keypoints (y, x, score): (1, 1, 17, 3), or (1, 6, 56) for several people."""

    label = "MoveNet"

    def _prepare(self) -> None:
        self.num_keypoints = 17
        self.several = len(self.outputs[0][1]) == 3
        sides = [int(n) for n in self.given[1:3] if isinstance(n, int) and n > 0]
        self.side = sides[0] if sides else 256

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        if len(outputs) != 1 or len(given) != 4 or given[3] != 3:
            return False
        return list(outputs[0][1])[-2:] == [17, 3] or outputs[0][1][-1] == 56

    def people(self, rgb: np.ndarray) -> np.ndarray:
        picture, scale = letterbox(rgb, (self.side, self.side), corner=False)
        rows = np.asarray(self.run(self.tensor(np.round(picture)))[0], np.float64)
        points = rows.reshape(-1, 56)[:, :51] if self.several else rows
        points = points.reshape(-1, 17, 3)[..., [1, 0, 2]] * [self.side, self.side, 1.0]
        score = rows.reshape(-1, 56)[:, 55] if self.several else points[..., 2].mean(axis=1)
        offset = 0.5 * (self.side - np.round(np.array(rgb.shape[1::-1]) * scale))
        corners = np.concatenate([points[..., :2].min(axis=1), points[..., :2].max(axis=1)], axis=1)
        return _chosen(corners, score, points, offset, scale, self.most)


KINDS = (_MoveNet, _RtmPose, _Rtmo, _YoloPose)  # Model types, tried in this order.


def suppressed(corners: np.ndarray, score: np.ndarray, most: int) -> list[int]:
    """Return the indices of boxes (N, 4) by descending score. Boxes that overlap a better box are skipped."""
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        if len(kept) >= most:
            break
        if (overlap(corners[i], corners[kept]) <= LARGEST_OVERLAP).all():
            kept.append(int(i))
    return kept


def _chosen(
    corners: np.ndarray, score: np.ndarray, points: np.ndarray, offset: Any, scale: float, most: int
) -> np.ndarray:
    """Select people by score and overlap. Return keypoints (P, K, 3) in pixels of the original image."""
    sure = np.flatnonzero(score >= LEAST_SCORE)
    kept = sure[suppressed(corners[sure], score[sure], most)]
    people = points[kept].astype(np.float64)
    # In both images the centre of the first pixel is (0, 0).
    people[..., :2] = (people[..., :2] + 0.5 - np.asarray(offset)) / scale - 0.5
    return people


def _box(person: np.ndarray) -> np.ndarray:
    """Return the box around a person's confident keypoints, or around all keypoints if few are confident."""
    points = person[person[:, 2] >= LEAST_SCORE, :2]
    points = points if len(points) >= 4 else person[:, :2]
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def _numbers(shape: list[Any]) -> bool:
    return all(isinstance(n, int) and n > 0 for n in shape)


def _is_whole(length: Any, head: int) -> bool:
    return isinstance(length, int) and length > head + 30 and (length - head) % 3 == 0 and length < 1000


def open_model(path: str) -> Any:
    """Open a model in onnxruntime. Raise ``Refused`` if that fails."""
    try:
        import onnxruntime
    except ImportError as error:
        hint = "Install it with `pip install onnxruntime`, or specify another Python with --python."
        message = f"The onnxruntime package is missing: {error} ({sys.executable})"
        raise Refused("detector_missing", message, hint) from error
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = THREADS
    settings.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exception types differ between releases
        message = f"The model cannot be loaded: {str(error).splitlines()[0]}"
        raise Refused("detector_missing", message, "Download it again.") from error


class OnnxPose:
    """Detects people with a known type of ONNX model."""

    def __init__(self, options: dict[str, Any]) -> None:
        path = options["model"]
        session = open_model(path)
        [given, *more] = session.get_inputs()
        outputs = session.get_outputs()
        shapes: list[tuple[str, list[Any]]] = [(o.name, list(o.shape)) for o in outputs]
        kind = None if more else next((k for k in KINDS if k.fits(list(given.shape), shapes)), None)
        if kind is None:
            inputs = [i.shape for i in session.get_inputs()]
            message = f"Inputs {inputs} and outputs {shapes} do not match a known model."
            hint = "Export RTMPose (SimCC), RTMO, YOLO-pose or MoveNet to ONNX without additional layers."
            raise Refused("detector_outputs_unknown", message, hint)

        def run(tensor: np.ndarray) -> list[np.ndarray]:
            return [np.asarray(value) for value in session.run(None, {given.name: tensor})]

        people = int(options.get("people", 1))
        self._model: _PoseModel = kind(list(given.shape), given.type, shapes, run, people)
        name = f"{kind.label} {os.path.splitext(os.path.basename(path))[0]}"
        self.about = {"name": name, "num_keypoints": self._model.num_keypoints, "people": people}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Detect the keypoints of all people (see ``PoseDetector``)."""
        return {"keypoints": self._model.people(rgb)}


if __name__ == "__main__":
    sys.exit(serve(OnnxPose))
