"""Fingers of a hand: by their names or, of five, by where they are."""

from __future__ import annotations

import numpy as np

from .names import words_of
from .roles import FINGERS
from .skeleton import Skeleton

_WORDS = {"thumb": "thumb", "index": "index", "middle": "middle", "mid": "middle", "ring": "ring", "pinky": "pinky",
          "little": "pinky", "pointer": "index"}  # fmt: skip
_KNUCKLE = 0.2
"""Distance of a knuckle from the wrist by the forearm, at least: what is nearer is a bone of the palm."""
_THUMB_DEG = 15.0
"""How far a thumb points away from the other fingers, at least."""
_CLEAR_GAP = 0.4
"""Share of the mean distance between fingers that any two neighbours keep, at least, for their order to be sure."""
_BONES = 3
"""Bones of a finger that roles are given to, as SMPL-H has them."""


def finger_roles(skeleton: Skeleton, hand: int, forearm: float) -> dict[str, int]:
    """Return the bones of the fingers by role without its side (``index_1``); what is not sure is left out.

    Args:
        skeleton: the skeleton.
        hand: the hand's bone.
        forearm: its length.
    """
    chains = [skeleton.main_path(child) for child in skeleton.children[hand]]
    chains = [chain for chain in chains if skeleton.distance(hand, chain[-1]) > _KNUCKLE * forearm]
    named = _by_names(skeleton, chains)
    found = named if len(named) == len(chains) else _by_places(skeleton, chains)
    roles = {}
    for finger, chain in found.items():
        bones = chain if finger == "thumb" else [b for b in chain if skeleton.distance(hand, b) > _KNUCKLE * forearm]
        roles |= {f"{finger}_{i + 1}": bone for i, bone in enumerate(bones[:_BONES])}
    return roles


def _by_names(skeleton: Skeleton, chains: list[list[int]]) -> dict[str, list[int]]:
    """Return the chains whose bones all bear the name of one finger, each finger once."""
    found: dict[str, list[int]] = {}
    for chain in chains:
        named = {_WORDS[word] for bone in chain for word in words_of(skeleton.names[bone]) if word in _WORDS}
        if len(named) == 1 and (finger := named.pop()) not in found:
            found[finger] = chain
    return found


def _by_places(skeleton: Skeleton, chains: list[list[int]]) -> dict[str, list[int]]:
    """Return five chains as fingers: the thumb points away, the others lie in order from it."""
    chains = [chain for chain in chains if len(chain) > 1]
    if len(chains) != len(FINGERS):
        return {}
    lengths = [skeleton.distance(chain[0], chain[-1]) for chain in chains]
    ways = np.array([skeleton.heads[chain[-1]] - skeleton.heads[chain[0]] for chain in chains])
    ways = ways / np.maximum(lengths, 1e-12)[:, None]
    angles = [np.degrees(np.arccos(np.clip(way @ _mean_of_others(ways, i), -1, 1))) for i, way in enumerate(ways)]
    order = np.argsort(angles)
    if angles[order[-1]] < max(_THUMB_DEG, 1.5 * angles[order[-2]]):
        return {}
    thumb, others = chains[order[-1]], [chains[i] for i in order[:-1]]
    middles = np.array([skeleton.heads[chain].mean(0) for chain in others])
    along = _mean_of_others(ways, int(order[-1]))
    across = skeleton.heads[thumb[0]] - middles.mean(0)
    across = across - (across @ along) * along
    aside = middles @ across / max(float(np.linalg.norm(across)), 1e-12)
    rank = np.argsort(-aside)
    gaps = -np.diff(aside[rank])
    if gaps.min() < _CLEAR_GAP * gaps.mean():
        return {}
    return {"thumb": thumb, **{finger: others[i] for finger, i in zip(FINGERS[1:], rank, strict=True)}}


def _mean_of_others(ways: np.ndarray, one: int) -> np.ndarray:
    mean = np.delete(ways, one, axis=0).mean(0)
    return mean / max(float(np.linalg.norm(mean)), 1e-12)
