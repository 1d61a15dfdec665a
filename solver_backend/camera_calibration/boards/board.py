"""Describe a calibration board, and detect it in images."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.pictures import opencv
from solver_backend.exchange.errors import JobInvalid
from solver_backend.io.files import read_toml
from solver_backend.types.shapes import Float, Int

KINDS = ("charuco", "checkerboard", "rings")
DEFAULT_DICTIONARY = "DICT_4X4_100"
MARKER_SHARE = 0.75  # Default side length of a marker, in squares.
EXAMPLE = "charuco:5x7:35mm, checkerboard:8x5:60mm, rings:4x11:40mm, or a board.toml"
_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}  # Size of each length unit in metres.
_LENGTH = re.compile(r"(\d+(?:\.\d+)?)(mm|cm|m|in)")


@dataclass(frozen=True)
class Board:
    """A flat board. Its first point is the origin. For the viewer, X points right and Y down."""

    kind: str
    columns: int  # Number of squares from left to right, or of rings in a row.
    rows: int  # Squares from top to bottom, or rows of rings. Every other row of rings is shifted by half a distance.
    square_m: float  # Side length of a square, or distance between rings in a row.
    marker_m: float = 0.0
    dictionary: str = DEFAULT_DICTIONARY  # OpenCV's name for the marker dictionary of a Charuco board.
    inverted: bool = False

    def __post_init__(self) -> None:
        square, marker = f"{self.square_m * 1000:g} mm", f"{self.marker_m * 1000:g} mm"
        if self.kind not in KINDS:
            message = f"Unknown board '{self.kind}'. Choose one of {', '.join(KINDS)}."
            raise JobInvalid(message, hint=f"Write {EXAMPLE}.")
        if not all(isinstance(count, int) and 3 <= count <= 50 for count in (self.columns, self.rows)):
            raise JobInvalid(f"A board must have 3 to 50 columns and rows, not {self.columns} x {self.rows}.")
        if not 0.001 <= self.square_m <= 2.0:
            raise JobInvalid(f"Squares of {square} are not possible. Their sides must be 1 mm to 2 m long.")
        if self.kind == "charuco" and not 0.3 * self.square_m <= self.marker_m < self.square_m:
            raise JobInvalid(f"A marker of {marker} does not fit in a square of {square}.")

    @property
    def points(self) -> Float[np.ndarray, "points 3"]:
        """(N, 3) positions in metres: inner corners row by row, or centres of rings. Z is 0."""
        if self.kind == "rings":
            row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
            x, y = (2 * column + row % 2) * self.square_m / 2, row * self.square_m / 2
        else:
            row, column = np.divmod(np.arange((self.columns - 1) * (self.rows - 1)), self.columns - 1)
            x, y = column * self.square_m, row * self.square_m
        return np.stack([x, y, np.zeros(len(x))], axis=-1)

    @property
    def ends_differ(self) -> bool:
        """True if the board looks different after rotation by 180°, so that its orientation is unambiguous."""
        return self.kind == "charuco" or (self.columns + self.rows) % 2 == 1

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the printed pattern in metres."""
        if self.kind == "rings":
            return (self.columns + 0.5) * self.square_m, (self.rows + 1) * self.square_m / 2
        return self.columns * self.square_m, self.rows * self.square_m

    def __str__(self) -> str:
        unit = "rings apart" if self.kind == "rings" else "squares"
        return f"{self.kind} of {self.columns} x {self.rows}, {unit} {self.square_m * 1000:g} mm"


def board_named(text: str) -> Board:
    """Read a board from text such as ``charuco:5x7:35mm``, or from a TOML file.

    The fields after the type may come in any order: columns x rows, side lengths (first of squares, then of markers),
    the name of a dictionary, and ``inverted``. Raise ``JobInvalid`` if a field is unknown, missing or impossible.
    """
    if text.lower().endswith(".toml"):
        return _from_table(read_toml(Path(text)), text)
    kind, *fields = text.split(":")
    counts: tuple[int, int] | None = None
    lengths: list[float] = []
    other: dict[str, Any] = {}
    for field in fields:
        length, count = _LENGTH.fullmatch(field.lower()), re.fullmatch(r"(\d+)[xX](\d+)", field)
        if length:
            lengths.append(round(float(length[1]) * _UNITS[length[2]], 9))
        elif count:
            counts = int(count[1]), int(count[2])
        elif field.upper().startswith("DICT_"):
            other["dictionary"] = field.upper()
        elif field.lower() == "inverted":
            other["inverted"] = True
        else:
            raise JobInvalid(f"'{field}' is not a property of a board.", where=text, hint=f"Write {EXAMPLE}.")
    if counts is None or not lengths:
        raise JobInvalid(
            "The number of columns and rows, or the size of the squares, is missing.",
            where=text,
            hint=f"Write {EXAMPLE}.",
        )
    marker = lengths[1] if len(lengths) > 1 else round(MARKER_SHARE * lengths[0], 9)
    return Board(kind.lower(), *counts, lengths[0], marker if kind.lower() == "charuco" else 0.0, **other)


def _from_table(table: dict[str, Any], where: str) -> Board:
    """Read the board from a TOML table in our own format, or in the format of caliscope's ``charuco.toml``."""
    try:
        if "board" in table:
            given = dict(table["board"])
            square, marker = given.pop("square_mm") / 1000.0, given.pop("marker_mm", 0.0) / 1000.0
            return Board(square_m=square, marker_m=marker, **given)
        charuco = table.get("charuco", table)
        square = float(charuco["square_size_override_cm"]) / 100.0
        board = Board("charuco", charuco["columns"], charuco["rows"], square, square * charuco["aruco_scale"])
        return replace(board, dictionary=charuco["dictionary"], inverted=bool(charuco["inverted"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        message = f"The board description is incomplete ({error})."
        raise JobInvalid(message, where=where, hint=f"Write {EXAMPLE}.") from error


FEWEST_POINTS = 6  # Minimum number of points in a usable sighting.
SMALLEST_SPACING_PX = 8.0  # Smallest distance in pixels between neighbouring points in a usable sighting.


@dataclass(frozen=True)
class BoardSighting:
    """A board detected in one image."""

    ids: Int[np.ndarray, " points"]  # (n,) indices of the board's points.
    px: Float[np.ndarray, "points 2"]  # (n, 2) pixels. (0, 0) is the centre of the first pixel.
    sharpness: float  # Spread of the Laplacian relative to the board's grey values: 1 in focus, 0.1 blurred.
    spacing_px: float
    mirrored: bool = False  # True if the image shows the board mirrored, as selfie cameras do.


class BoardDetector:
    """Detects a given board in images. Raises ``JobInvalid`` if OpenCV has no suitable marker dictionary."""

    def __init__(self, board: Board) -> None:
        self.board, self._cv2 = board, opencv()
        made = charuco_boards(board) if board.kind == "charuco" else []
        self._charucos = [self._cv2.aruco.CharucoDetector(one) for one in made]
        self._points = {"charuco": self._charuco, "rings": self._rings, "checkerboard": self._checkerboard}[board.kind]

    def find(self, grey: np.ndarray) -> BoardSighting | None:
        """Detect the board in a grey image (H, W) uint8. Return None if it is not found."""
        picture = 255 - grey if self.board.inverted else grey
        found, mirrored = self._points(picture), False
        if found is None and self.board.kind == "charuco":
            found, mirrored = self._points(np.ascontiguousarray(picture[:, ::-1])), True
        if found is None:
            return None
        ids, px = found
        if mirrored:
            px = np.array([grey.shape[1] - 1.0, 0.0]) + px * [-1.0, 1.0]
        spacing = _spacing(self.board, ids, px)
        if spacing < SMALLEST_SPACING_PX:
            return None
        return BoardSighting(ids, px, _sharpness(self._cv2, grey, px), spacing, mirrored)

    def _charuco(self, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        for i, detector in enumerate(self._charucos):
            corners, ids, _, markers = detector.detectBoard(picture)
            if markers is None or len(markers) < 2:
                return None
            if ids is not None and len(ids) >= FEWEST_POINTS:
                self._charucos.insert(0, self._charucos.pop(i))
                ids, order, board = ids.ravel(), np.argsort(ids.ravel()), self.board
                corners, reach = corners.reshape(-1, 2), (board.square_m - board.marker_m) / board.square_m
                window = int(np.clip(0.4 * reach * _spacing(board, ids, corners), 2, 12))
                return ids[order], _refined(self._cv2, picture, corners - 0.5, window)[order]
        return None

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
    """Return two OpenCV boards: one with the current Charuco pattern, and one with the pattern before OpenCV 4.6."""
    cv2 = opencv()
    number = getattr(cv2.aruco, board.dictionary, None)
    if number is None:
        raise JobInvalid(f"OpenCV has no dictionary {board.dictionary}.", hint="Use a known one, such as DICT_4X4_100.")
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    needed = board.columns * board.rows // 2
    if len(dictionary.bytesList) < needed:
        raise JobInvalid(f"{board.dictionary} has {len(dictionary.bytesList)} markers, but the board needs {needed}.")
    size = board.columns, board.rows
    boards = [cv2.aruco.CharucoBoard(size, board.square_m, board.marker_m, dictionary) for _ in range(2)]
    boards[1].setLegacyPattern(True)
    return boards


def _refined(cv2: Any, picture: np.ndarray, px: np.ndarray, window: int) -> np.ndarray:
    """Refine (n, 2) corners using the grey values within ``window`` px."""
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    start = np.ascontiguousarray(px, dtype=np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(picture, start, (window, window), (-1, -1), until).reshape(-1, 2).astype(np.float64)


def _spacing(board: Board, ids: np.ndarray, px: np.ndarray) -> float:
    """Return the median distance in px between neighbouring board points."""
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
    first, second = (picture[tuple(np.rint(grid[:2, i : i + 2].mean((0, 1))[::-1]).astype(int))] for i in (0, 1))
    return bool(first > second)


def point_velocities(sightings: Mapping[int, BoardSighting], frame: int, fps: float) -> Float[np.ndarray, "points 2"]:
    """Estimate the image velocities (n, 2) of n visible board points in px/s from the neighbouring frames.

    Points that neighbouring frames do not show get the median velocity of the other points. All velocities are NaN if
    no neighbouring frame shows the board.
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
