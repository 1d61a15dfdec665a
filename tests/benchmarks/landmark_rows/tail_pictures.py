"""Picture of the tail: input cloud, truth, and markers and joints of each row."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

from solver_backend.exchange.joint_sets import SMPL_PARENTS
from solver_backend.labelling.outputs import LANDMARKS, MARKERS
from training.landmarks.cloud_stream import Clouds
from training.landmarks.models import LandmarkModel

CELL = (170, 190)  # Size of one body's picture in pixels.
FINER = 3  # Factor of supersampling.
HEIGHT_M = 2.15
TURN = np.radians(25.0)
TRUTH, ANSWER, CLOUD, APART = (120, 128, 140), (30, 90, 170), (60, 60, 60), (225, 80, 60)
SHOWN = (0.5, 0.9)
"""Quantiles of a group's errors at which its poses are shown."""


@torch.no_grad()
def landmarks(model: LandmarkModel, clouds: Clouds) -> np.ndarray:
    """Return (B, 77, 3) landmarks, NaN if the network does not estimate a landmark."""
    told = np.full((len(clouds.points), len(LANDMARKS), 3), np.nan)
    told[:, list(model.columns)] = model.positions(clouds).numpy()
    return told


def representative(error: np.ndarray, groups: np.ndarray) -> list[int]:
    """Return the poses of each group with the group's median and 90th percentile errors (``SHOWN``)."""
    rows: list[int] = []
    for group in np.unique(groups):
        mine = np.flatnonzero(groups == group)
        order = mine[np.argsort(error[mine])]
        rows += [int(order[round(share * (len(order) - 1))]) for share in SHOWN]
    return rows


def draw_tail(
    path: Path, truth: np.ndarray, points: list[np.ndarray], titles: list[str], answers: Mapping[str, np.ndarray]
) -> None:
    """Write the picture: a row of clouds over the truth, and a row for each network.

    Args:
        path: path of the picture.
        truth: (B, 77, 3) landmarks in metres, Z up.
        points: (n, 3) input points of each cloud.
        titles: titles of the B columns.
        answers: (B, 77, 3) landmarks by network, NaN if not estimated.
    """
    sheet = Image.new("RGB", (100 + CELL[0] * len(truth), 24 + CELL[1] * (1 + len(answers))), "white")
    pen = ImageDraw.Draw(sheet)
    for number, title in enumerate(titles):
        pen.text((104 + CELL[0] * number, 6), title, fill="black")
    for line, name in enumerate(("cloud and truth", *answers)):
        pen.text((6, 24 + CELL[1] * line + CELL[1] // 2), name, fill="black")
        for column, body in enumerate(truth):
            cell = _cell(body, answers[name][column], None) if line else _cell(body, None, points[column])
            sheet.paste(cell, (100 + CELL[0] * column, 24 + CELL[1] * line))
    sheet.save(path)


def _cell(truth: np.ndarray, answer: np.ndarray | None, points: np.ndarray | None) -> Image.Image:
    size = (FINER * CELL[0], FINER * CELL[1])
    image = Image.new("RGB", size, "white")
    pen = ImageDraw.Draw(image)
    middle = 0.5 * (truth.min(axis=0) + truth.max(axis=0))
    seen = _screen(truth, middle)
    _bones(pen, seen, TRUTH)
    if points is not None:
        for x, y in _screen(points, middle):
            pen.ellipse((x - 5, y - 5, x + 5, y + 5), fill=CLOUD)
    if answer is not None:
        told = _screen(answer, middle)
        for a, b in zip(seen, told, strict=True):
            if np.isfinite(b).all():
                pen.line((*a, *b), fill=APART, width=3)
        _bones(pen, told, ANSWER)
    return image.resize(CELL, Image.Resampling.LANCZOS)


def _screen(points: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return (N, 2) pixels of Z-up points, seen from the front and slightly from the side."""
    c, s = np.cos(TURN), np.sin(TURN)
    x, _, z = np.moveaxis(points - middle, -1, 0)
    x = c * x + s * (points - middle)[:, 1]
    scale = FINER * CELL[1] / HEIGHT_M
    return np.stack([FINER * CELL[0] / 2 + scale * x, FINER * CELL[1] / 2 - scale * z], axis=1)


def _bones(pen: ImageDraw.ImageDraw, seen: np.ndarray, colour: tuple[int, int, int]) -> None:
    """Draw bones to the nearest estimated ancestor joint."""
    joints = seen[len(MARKERS) :]
    for joint, parent in enumerate(SMPL_PARENTS):
        while parent >= 0 and not np.isfinite(joints[parent]).all():
            parent = SMPL_PARENTS[parent]
        if parent >= 0 and np.isfinite(joints[joint]).all():
            pen.line((*joints[parent], *joints[joint]), fill=colour, width=9)
