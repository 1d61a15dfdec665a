"""Find a board's corners in pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.pictures import opencv
from solver_backend.exchange.errors import JobInvalid
from solver_backend.types.shapes import Float, Int

FEWEST_POINTS = 6
"""Fewest points of a usable sighting."""
SMALLEST_SPACING_PX = 8.0
"""Least distance of neighbouring points in a usable sighting, in pixels."""


@dataclass(frozen=True)
class BoardSighting:
    """A board found in one picture."""

    ids: Int[np.ndarray, " points"]
    """(n,) indices of the board's points."""
    px: Float[np.ndarray, "points 2"]
    """(n, 2) pixels. (0, 0) is the middle of the first pixel."""
    sharpness: float
    """Spread of the Laplacian by the spread of the grey values on the board: about 1 in focus, 0.1 blurred."""
    spacing_px: float
    mirrored: bool = False
    """The picture shows the board mirrored, as a selfie camera does."""


class BoardDetector:
    """Find one board in pictures.

    Raises:
        JobInvalid: the dictionary has no such name or too few markers.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self._cv2 = opencv()
        self._charucos: list[Any] = []
        if board.kind == "charuco":
            self._charucos = [self._cv2.aruco.CharucoDetector(b) for b in charuco_boards(board)]

    def find(self, grey: np.ndarray) -> BoardSighting | None:
        """Return the board in a grey picture (H, W) uint8, or None."""
        picture = 255 - grey if self.board.inverted else grey
        found, mirrored = self._points(picture), False
        if found is None and self.board.kind == "charuco":
            width = grey.shape[1]
            found = self._points(np.ascontiguousarray(picture[:, ::-1]))
            if found is not None:
                mirrored, found = True, (found[0], np.array([width - 1.0, 0.0]) + found[1] * [-1.0, 1.0])
        if found is None:
            return None
        ids, px = found
        spacing = _spacing(self.board, ids, px)
        if spacing < SMALLEST_SPACING_PX:
            return None
        return BoardSighting(ids, px, _sharpness(self._cv2, grey, px), spacing, mirrored)

    def _points(self, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        if self.board.kind == "charuco":
            return self._charuco(picture)
        return self._rings(picture) if self.board.kind == "rings" else self._checkerboard(picture)

    def _charuco(self, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        for i, detector in enumerate(self._charucos):
            corners, ids, _, markers = detector.detectBoard(picture)
            if markers is None or len(markers) < 2:
                return None
            if ids is not None and len(ids) >= FEWEST_POINTS:
                self._charucos.insert(0, self._charucos.pop(i))
                order = np.argsort(ids.ravel())
                return ids.ravel()[order], self._charuco_corners(picture, ids.ravel(), corners.reshape(-1, 2))[order]
        return None

    def _charuco_corners(self, picture: np.ndarray, ids: np.ndarray, corners: np.ndarray) -> np.ndarray:
        reach = self.board.square_m - self.board.marker_m
        window = int(np.clip(0.4 * reach / self.board.square_m * _spacing(self.board, ids, corners), 2, 12))
        return _refined(self._cv2, picture, corners - 0.5, window)

    def _checkerboard(self, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        cv2, size = self._cv2, (self.board.columns - 1, self.board.rows - 1)
        shrink = max(1.0, max(picture.shape) / 1000.0)
        small = cv2.resize(picture, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        fast = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        good, corners = cv2.findChessboardCornersSB(small, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not good:
            good, corners = cv2.findChessboardCorners(small, size, flags=fast)
        if not good:
            return None
        px = (corners.reshape(-1, 2).astype(np.float64) + 0.5) * shrink - 0.5
        reach = max(2, int(0.35 * _spacing(self.board, np.arange(len(px)), px)))
        px = _refined(cv2, picture, px, min(reach, 15))
        if _first_square_is_light(picture, px, size):
            px = px[::-1]
        return np.arange(len(px)), px

    def _rings(self, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        cv2, size = self._cv2, (self.board.columns, self.board.rows)
        parameters = cv2.SimpleBlobDetector_Params()
        parameters.filterByColor = False
        parameters.minArea, parameters.maxArea = 20.0, picture.size / 40.0
        blobs = cv2.SimpleBlobDetector_create(parameters)
        good, centres = cv2.findCirclesGrid(picture, size, flags=cv2.CALIB_CB_ASYMMETRIC_GRID, blobDetector=blobs)
        return (np.arange(size[0] * size[1]), centres.reshape(-1, 2).astype(np.float64)) if good else None


def charuco_boards(board: Board) -> list[Any]:
    """Return OpenCV's boards of today and of before version 4.6, which differ for even rows.

    Raises:
        JobInvalid: the dictionary has no such name or too few markers.
    """
    cv2 = opencv()
    number = getattr(cv2.aruco, board.dictionary, None)
    if number is None:
        raise JobInvalid(f"OpenCV has no dictionary {board.dictionary}.", hint="Such as DICT_4X4_100, DICT_5X5_250.")
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    needed = board.columns * board.rows // 2
    if len(dictionary.bytesList) < needed:
        raise JobInvalid(f"{board.dictionary} has {len(dictionary.bytesList)} markers; the board needs {needed}.")
    boards = []
    for legacy in (False, True):
        made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, dictionary)
        made.setLegacyPattern(legacy)
        boards.append(made)
    return boards


def _refined(cv2: Any, picture: np.ndarray, px: np.ndarray, window: int) -> np.ndarray:
    """Return corners (n, 2) to fractions of a pixel, by the grey values within ``window`` px."""
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    start = np.ascontiguousarray(px, dtype=np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(picture, start, (window, window), (-1, -1), until).reshape(-1, 2).astype(np.float64)


def _spacing(board: Board, ids: np.ndarray, px: np.ndarray) -> float:
    """Return the median distance in px of points that are neighbours on the board."""
    points = board.points[ids, :2]
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    near = (apart > 0) & (apart < 1.01 * board.square_m)
    if not near.any():
        return 0.0
    return float(np.median(np.linalg.norm(px[:, None] - px[None], axis=-1)[near]))


def _sharpness(cv2: Any, grey: np.ndarray, px: np.ndarray) -> float:
    low, high = np.floor(px.min(0)).astype(int), np.ceil(px.max(0)).astype(int) + 1
    low, high = np.maximum(low, 0), np.minimum(high, grey.shape[::-1])
    part = grey[low[1] : high[1], low[0] : high[0]]
    if part.size < 9:
        return 0.0
    return float(cv2.Laplacian(part, cv2.CV_64F).std() / max(float(part.std()), 1e-6))


def _first_square_is_light(picture: np.ndarray, px: np.ndarray, size: tuple[int, int]) -> bool:
    grid = px.reshape(size[1], size[0], 2)
    first, second = (grid[0:2, i : i + 2].reshape(-1, 2).mean(0) for i in (0, 1))
    values = [float(picture[round(y), round(x)]) for x, y in (first, second)]
    return values[0] > values[1]


def point_velocities(sightings: Mapping[int, BoardSighting], frame: int, fps: float) -> Float[np.ndarray, "points 2"]:
    """Return (n, 2) px/s of the points seen at a frame: central differences, one-sided where one neighbour is missing.

    A point without neighbours moves like the median of the others. NaN where no frame beside saw the board.

    Args:
        sightings: of one camera, by the frame's number.
        fps: frames per second.
    """
    here = sightings[frame]
    steps = np.full((2, len(here.ids), 2), np.nan)
    for i, sign in enumerate((-1, 1)):
        beside = sightings.get(frame + sign)
        if beside is not None:
            _, mine, theirs = np.intersect1d(here.ids, beside.ids, return_indices=True)
            steps[i, mine] = sign * (beside.px[theirs] - here.px[mine]) * fps
    known = np.isfinite(steps)
    total = np.where(known, steps, 0.0).sum(0)
    velocity = np.divide(total, known.sum(0), out=np.full_like(total, np.nan), where=known.any(0))
    measured = np.isfinite(velocity).all(-1)
    if measured.any():
        velocity[~measured] = np.median(velocity[measured], axis=0)
    return velocity
