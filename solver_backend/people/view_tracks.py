"""Detections followed through one view's frames: pieces of tracks that surely are one person."""

from __future__ import annotations

import numpy as np

from solver_backend.people.sightings import Sightings

STEP_SHARE = 0.2
"""From frame to frame a person's keypoints move by less than this share of the person's size."""
CLEAR_RATIO = 2.0
"""A link is sure where the next candidate is this many times further away."""


def view_tracks(seen: Sightings) -> np.ndarray:
    """Return (C, F, P) the number of the track each detection belongs to; -1 where there is none.

    Two detections of neighbouring frames are linked where each is the other's nearest by far; anything doubtful, such
    as two people who cross, ends a track. Numbers are unique over all views.
    """
    views, frames, people = seen.xy.shape[:3]
    present = seen.present()
    tracks = np.full((views, frames, people), -1)
    links = np.stack([_links(seen.xy[c]) for c in range(views)])
    rows = np.arange(views)[:, None]
    next_number = 0
    for f in range(frames):
        if f:
            source = links[:, f - 1]
            linked = source >= 0
            tracks[:, f][linked] = tracks[rows, f - 1, source][linked]
        fresh = present[:, f] & (tracks[:, f] < 0)
        count = int(fresh.sum())
        tracks[:, f][fresh] = next_number + np.arange(count)
        next_number += count
        tracks[:, f][~present[:, f]] = -1
    return tracks


def _links(xy: np.ndarray) -> np.ndarray:
    """Return (F-1, P) for each detection of frames 1.. the detection of the frame before that it is; -1 = none.

    Args:
        xy: (F, P, J, 2) normalised coordinates of one view.
    """
    cost = _costs(xy)
    if not cost.size:
        return np.zeros(cost.shape[:2], np.int64)
    before = np.argmin(cost, axis=1)
    after = np.argmin(cost, axis=2)
    people = np.arange(cost.shape[1])
    mutual = np.take_along_axis(after, before, axis=1) == people
    best = np.take_along_axis(cost, before[:, None, :], axis=1)[:, 0]
    backward = np.take_along_axis(_second(cost, 1), people[None], axis=1)
    forward = np.take_along_axis(_second(cost, 2), before, axis=1)
    clear = np.minimum(backward, forward) > CLEAR_RATIO * best
    return np.where(mutual & clear & (best < STEP_SHARE), before, -1)


def _second(cost: np.ndarray, axis: int) -> np.ndarray:
    """Return the second smallest cost along an axis; inf where there is only one."""
    if cost.shape[axis] < 2:
        return np.full(cost.shape[:axis] + cost.shape[axis + 1 :], np.inf)
    return np.take(np.partition(cost, 1, axis=axis), 1, axis=axis)


def _costs(xy: np.ndarray) -> np.ndarray:
    """Return (F-1, P, P) mean distance of common keypoints over the size of the person; inf where none are common."""
    known = np.isfinite(xy[..., 0])
    middle = np.where(known[..., None], xy, 0.0).sum(-2) / np.maximum(known.sum(-1), 1)[..., None]
    spread = np.where(known[..., None], xy - middle[..., None, :], 0.0)
    size = 3.0 * np.sqrt((spread**2).sum((-1, -2)) / np.maximum(known.sum(-1), 1))
    people = xy.shape[1]
    cost = np.full((max(len(xy) - 1, 0), people, people), np.inf)
    for p in range(people):
        for q in range(people):
            apart = np.linalg.norm(xy[1:, q] - xy[:-1, p], axis=-1)
            common = np.isfinite(apart)
            count = common.sum(-1)
            mean = np.where(common, apart, 0.0).sum(-1) / np.maximum(count, 1)
            scale = np.maximum(np.minimum(size[1:, q], size[:-1, p]), 1e-6)
            cost[:, p, q] = np.where(count >= 3, mean / scale, np.inf)
    return cost
