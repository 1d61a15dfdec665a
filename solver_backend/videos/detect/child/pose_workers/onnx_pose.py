"""Run pose models in ONNX files: RTMPose, RTMO, YOLO-pose and MoveNet, recognised by their inputs and outputs.

Picture models (RTMO, YOLO-pose, MoveNet) find people by themselves. RTMPose looks at one box at a time and follows the
people from picture to picture, starting with the whole picture.

RTMPose: Jiang et al. 2023, SimCC of Li et al. 2022; RTMO: Lu et al. 2024; YOLO-pose: Maji et al. 2022 and Ultralytics'
layout of outputs; MoveNet: Google's model cards.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from .serve import Refused, serve

PADDING = 114.0
"""Grey of what lies outside a picture."""


def crop(rgb: np.ndarray, low: np.ndarray, high: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return (h, w, 3) float32 of the box from ``low`` to ``high`` (x, y), bilinear, black outside.

    Column j of the result is ``x = low + (high - low) j / w``, as models are trained that map a box's corner to the
    first pixel.
    """
    width, height = size
    x = low[0] + (high[0] - low[0]) * np.arange(width) / width
    y = low[1] + (high[1] - low[1]) * np.arange(height) / height
    return sampled(rgb, x, y, 0.0)


def letterbox(rgb: np.ndarray, size: tuple[int, int], *, corner: bool) -> tuple[np.ndarray, float]:
    """Return the whole picture scaled into (h, w, 3), grey beside it, and the scale.

    It stands in the upper left corner, or in the middle. Pixel centres keep their place: ``x' + 1/2 = s (x + 1/2)``.
    """
    width, height = size
    scale = min(width / rgb.shape[1], height / rgb.shape[0])
    used = [round(n * scale) for n in (rgb.shape[1], rgb.shape[0])]
    start = (0.0, 0.0) if corner else (0.5 * (width - used[0]), 0.5 * (height - used[1]))
    x = (np.arange(width) - start[0] + 0.5) / scale - 0.5
    y = (np.arange(height) - start[1] + 0.5) / scale - 0.5
    return sampled(rgb, x, y, PADDING), scale


def sampled(rgb: np.ndarray, x: np.ndarray, y: np.ndarray, outside: float) -> np.ndarray:
    """Return (len(y), len(x), 3) float32, bilinear at columns x and rows y. ``outside`` beyond the picture."""
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
LEAST_SCORE = 0.3
"""People less sure than this are nobody."""
LARGEST_OVERLAP = 0.65
"""Of two boxes that overlap by more (intersection over union) the less sure one is the same person."""
_MEAN, _STD = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])
"""Of ImageNet's pictures, RGB 0..255, which RTMPose is trained with."""


class Model:
    """A kind of model. ``people`` returns (P, K, 3) x, y, confidence."""

    label = ""

    def __init__(self, given: list[Any], kind: str, outputs: Outputs, run: Run, most: int) -> None:
        self.given, self.type, self.outputs, self.run, self.most = given, kind, outputs, run, most
        self.num_keypoints = 0

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        """Return whether inputs and outputs are this kind's."""
        raise NotImplementedError

    def people(self, rgb: np.ndarray) -> np.ndarray:
        """Return who is in a picture."""
        raise NotImplementedError

    def tensor(self, picture: np.ndarray) -> np.ndarray:
        """Return a picture (H, W, 3) as the model's type, channels where it wants them."""
        value = picture[None] if self.given[-1] == 3 else picture.transpose(2, 0, 1)[None]
        kind = {"tensor(int32)": np.int32, "tensor(uint8)": np.uint8, "tensor(float16)": np.float16}
        return np.ascontiguousarray(value.astype(kind.get(self.type, np.float32)))


class RtmPose(Model):
    """Top-down, SimCC: a row of scores for each axis, ``x = argmax / ratio``, confidence the lower of both maxima."""

    label = "RTMPose"
    padding = 1.25
    """A person's box grows by this factor."""

    def __init__(self, given: list[Any], kind: str, outputs: Outputs, run: Run, most: int) -> None:
        super().__init__(given, kind, outputs, run, most)
        self.size = (int(given[3]), int(given[2]))
        self.boxes: list[np.ndarray] = []
        self.num_keypoints = int(outputs[0][1][1])

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        """Two outputs (N, K, W ratio) and (N, K, H ratio) of a picture (N, 3, H, W)."""
        if len(outputs) != 2 or len(given) != 4 or given[1] != 3 or not _numbers(given[2:]):
            return False
        (_, x), (_, y) = outputs
        if len(x) != 3 or len(y) != 3 or not _numbers([*x[1:], *y[1:]]) or x[1] != y[1]:
            return False
        return x[2] % given[3] == 0 and x[2] // given[3] == y[2] / given[2]

    def people(self, rgb: np.ndarray) -> np.ndarray:
        """Look into the boxes of the people of the last picture. Into the whole picture where there are none."""
        whole = np.array([0.0, 0.0, rgb.shape[1], rgb.shape[0]])
        found = [self._in_box(rgb, box) for box in self.boxes]
        if not any(_is_somebody(person) for person in found):
            first = self._in_box(rgb, whole)
            found = [self._in_box(rgb, _box(first))] if _is_somebody(first) else []
        sure = [person for person in found if _is_somebody(person)]
        kept = suppressed(np.array([_box(p) for p in sure]), np.array([p[:, 2].mean() for p in sure]), self.most)
        sure = [sure[i] for i in kept]
        self.boxes = [_box(person) for person in sure]
        return np.stack(sure) if sure else np.zeros((0, self.num_keypoints, 3))

    def _in_box(self, rgb: np.ndarray, box: np.ndarray) -> np.ndarray:
        width, height = self.size
        centre, span = 0.5 * (box[:2] + box[2:]), np.maximum(box[2:] - box[:2], 1.0) * self.padding
        span = np.maximum(span, span[::-1] * [width / height, height / width])
        low = centre - 0.5 * span
        picture = (crop(rgb, low, low + span, (width, height)) - _MEAN) / _STD
        x, y = (np.asarray(a, np.float64)[0] for a in self.run(self.tensor(picture)))
        ratio = x.shape[1] / width
        at = np.stack([x.argmax(axis=1), y.argmax(axis=1)], axis=1) / ratio
        score = np.minimum(x.max(axis=1), y.max(axis=1))
        return np.concatenate([low + at * span / (width, height), np.clip(score, 0.0, 1.0)[:, None]], axis=1)


class Rtmo(Model):
    """One-stage: boxes (N, P, 5) and keypoints (N, P, K, 3) in the pixels of the letterboxed picture, BGR."""

    label = "RTMO"

    def __init__(self, given: list[Any], kind: str, outputs: Outputs, run: Run, most: int) -> None:
        super().__init__(given, kind, outputs, run, most)
        self.points = next(i for i, (_, shape) in enumerate(outputs) if len(shape) == 4)
        self.num_keypoints = int(outputs[self.points][1][2])

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        """See the class."""
        by_rank = {len(shape): shape for _, shape in outputs}
        if len(outputs) != 2 or set(by_rank) != {3, 4} or given[1] != 3 or not _numbers(given[2:]):
            return False
        return by_rank[3][2] == 5 and by_rank[4][3] == 3 and _numbers(by_rank[4][2:])

    def people(self, rgb: np.ndarray) -> np.ndarray:
        """Return everybody the model is sure of."""
        picture, scale = letterbox(rgb[..., ::-1], (int(self.given[3]), int(self.given[2])), corner=True)
        both = self.run(self.tensor(picture))
        boxes, points = np.asarray(both[1 - self.points])[0], np.asarray(both[self.points], np.float64)[0]
        return _chosen(boxes[:, :4], boxes[:, 4], points, (0.0, 0.0), scale, self.most)


class YoloPose(Model):
    """One row a candidate: box by centre and size, score, K keypoints. Or, with its own suppression, corners and class.

    (N, 5 + 3K, candidates) as Ultralytics exports it, or (N, candidates, 6 + 3K) with suppression in the model.
    """

    label = "YOLO-pose"

    def __init__(self, given: list[Any], kind: str, outputs: Outputs, run: Run, most: int) -> None:
        super().__init__(given, kind, outputs, run, most)
        shape = outputs[0][1]
        self.finished = _is_whole(shape[2], 6)
        self.num_keypoints = (shape[2] - 6) // 3 if self.finished else (shape[1] - 5) // 3

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        """See the class."""
        if len(outputs) != 1 or len(given) != 4 or given[1] != 3 or not _numbers(given[2:]):
            return False
        shape = outputs[0][1]
        return len(shape) == 3 and (_is_whole(shape[2], 6) or _is_whole(shape[1], 5))

    def people(self, rgb: np.ndarray) -> np.ndarray:
        """Return everybody the model is sure of."""
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


class MoveNet(Model):
    """Keypoints y, x, score in shares of the letterboxed picture: (1, 1, 17, 3), or (1, 6, 56) of several people."""

    label = "MoveNet"

    def __init__(self, given: list[Any], kind: str, outputs: Outputs, run: Run, most: int) -> None:
        super().__init__(given, kind, outputs, run, most)
        self.num_keypoints = 17
        self.several = len(outputs[0][1]) == 3
        sides = [int(n) for n in given[1:3] if isinstance(n, int) and n > 0]
        self.side = sides[0] if sides else 256

    @classmethod
    def fits(cls, given: list[Any], outputs: Outputs) -> bool:
        """See the class."""
        if len(outputs) != 1 or len(given) != 4 or given[3] != 3:
            return False
        return list(outputs[0][1])[-2:] == [17, 3] or outputs[0][1][-1] == 56

    def people(self, rgb: np.ndarray) -> np.ndarray:
        """Return the people the model is sure of."""
        picture, scale = letterbox(rgb, (self.side, self.side), corner=False)
        rows = np.asarray(self.run(self.tensor(np.round(picture)))[0], np.float64)
        points = rows.reshape(-1, 56)[:, :51] if self.several else rows
        points = points.reshape(-1, 17, 3)[..., [1, 0, 2]] * [self.side, self.side, 1.0]
        score = rows.reshape(-1, 56)[:, 55] if self.several else points[..., 2].mean(axis=1)
        offset = 0.5 * (self.side - np.round(np.array(rgb.shape[1::-1]) * scale))
        corners = np.concatenate([points[..., :2].min(axis=1), points[..., :2].max(axis=1)], axis=1)
        return _chosen(corners, score, points, offset, scale, self.most)


KINDS = (MoveNet, RtmPose, Rtmo, YoloPose)
"""Asked in this order."""


def suppressed(corners: np.ndarray, score: np.ndarray, most: int) -> list[int]:
    """Return which boxes (N, 4) stay, the surest first: each less sure one that overlaps a kept one goes."""
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        if len(kept) >= most:
            break
        if all(_overlap(corners[i], corners[j]) <= LARGEST_OVERLAP for j in kept):
            kept.append(int(i))
    return kept


def _chosen(
    corners: np.ndarray, score: np.ndarray, points: np.ndarray, offset: Any, scale: float, most: int
) -> np.ndarray:
    """Return the keypoints (P, K, 3) of the people who stay, in the pixels of the picture that was filmed."""
    sure = np.flatnonzero(score >= LEAST_SCORE)
    kept = sure[suppressed(corners[sure], score[sure], most)]
    people = points[kept].astype(np.float64)
    # Centres of pixels: the middle of the first one is (0, 0) in both pictures.
    people[..., :2] = (people[..., :2] + 0.5 - np.asarray(offset)) / scale - 0.5
    return people


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    both = np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0.0).prod()
    return float(both / max((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - both, 1e-9))


def _box(person: np.ndarray) -> np.ndarray:
    """Return the box around the sure keypoints of a person, around all where few are sure."""
    points = person[person[:, 2] >= LEAST_SCORE, :2]
    points = points if len(points) >= 4 else person[:, :2]
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def _is_somebody(person: np.ndarray | None) -> bool:
    return person is not None and float(np.median(person[:, 2])) >= LEAST_SCORE


def _numbers(shape: list[Any]) -> bool:
    return all(isinstance(n, int) and n > 0 for n in shape)


def _is_whole(length: Any, head: int) -> bool:
    return isinstance(length, int) and length > head + 30 and (length - head) % 3 == 0 and length < 1000


class OnnxPose:
    """Runs a model by onnxruntime."""

    def __init__(self, options: dict[str, Any]) -> None:
        path = options["model"]
        try:
            import onnxruntime
        except ImportError as error:
            raise Refused(
                "detector_missing",
                f"This Python has no onnxruntime: {error} ({sys.executable})",
                "Install it with: pip install onnxruntime; or name another Python with --python.",
            ) from error
        settings = onnxruntime.SessionOptions()
        settings.intra_op_num_threads = int(options.get("threads", 1))
        settings.log_severity_level = 3
        try:
            session = onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own kinds differ between its releases
            raise Refused(
                "detector_missing", f"The model cannot be loaded: {str(error).splitlines()[0]}", "Download it again."
            ) from error
        [given, *more] = session.get_inputs()
        outputs = session.get_outputs()
        shapes: list[tuple[str, list[Any]]] = [(o.name, list(o.shape)) for o in outputs]
        kind = None if more else next((k for k in KINDS if k.fits(list(given.shape), shapes)), None)
        if kind is None:
            raise Refused(
                "detector_outputs_unknown",
                f"Inputs {[i.shape for i in session.get_inputs()]} and outputs {shapes} are of no known kind.",
                "Export RTMPose (SimCC), RTMO, YOLO-pose or MoveNet to ONNX without further steps.",
            )

        def run(tensor: np.ndarray) -> list[np.ndarray]:
            return [np.asarray(value) for value in session.run(None, {given.name: tensor})]

        self._model: Model = kind(list(given.shape), given.type, shapes, run, int(options.get("people", 1)))
        self.about = {
            "name": f"{kind.label} {os.path.splitext(os.path.basename(path))[0]}",
            "num_keypoints": self._model.num_keypoints,
            "people": int(options.get("people", 1)),
        }

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return keypoints, see ``PoseDetector``."""
        return {"keypoints": self._model.people(rgb)}


if __name__ == "__main__":
    sys.exit(serve(OnnxPose))
