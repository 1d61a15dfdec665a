"""The parts of arms, legs and feet in keypoint vocabularies, without their side."""

from __future__ import annotations

LIMBS: dict[str, tuple[str, ...]] = {"arms": ("shoulder", "elbow", "wrist"), "legs": ("hip", "knee", "ankle")}
"""Joints of each side that every detector finds, from the trunk outwards."""
FEET: tuple[str, ...] = ("big_toe", "small_toe", "heel", "foot")
"""Points of each side's foot, where a vocabulary has them."""
