"""Define the order of the unknowns of a pose, and of a pose's state with a prior's code."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

CODE, ROOT, TRANSL, UNCOVERED, RESIDUAL = "code", "root", "transl", "uncovered", "residual"
"""Blocks of a state: the prior's code, the root's left rotation (world), the translation, the rotation vectors of
joints without a prior, and residual rotation vectors of joints with a prior."""


@dataclass(frozen=True)
class PoseLayout:
    """Order of a pose's tangent vector: left rotations of the root and the joints, then the translation in metres.

    A tangent δ moves a pose by ``R(δ) = exp([δ]x) R`` and ``t(δ) = t + δ``.
    """

    num_joints: int

    @property
    def dof(self) -> int:
        """Number of entries in a pose's tangent vector."""
        return self.transl.stop

    @property
    def root(self) -> slice:
        """Tangent entries of the root's rotation."""
        return slice(0, 3)

    @property
    def joints(self) -> slice:
        """Tangent entries of the rotations of all joints after the root."""
        return slice(3, 3 + 3 * self.num_joints)

    @property
    def rotations(self) -> slice:
        """Tangent entries of the rotations of the root and all joints."""
        return slice(0, self.joints.stop)

    @property
    def transl(self) -> slice:
        """Tangent entries of the translation."""
        return slice(self.joints.stop, self.joints.stop + 3)

    def joint(self, column: int) -> slice:
        """Return the tangent entries of one joint's rotation. Column 0 is the first joint after the root."""
        first = self.joints.start + 3 * column
        return slice(first, first + 3)


@dataclass(frozen=True)
class Block:
    """Named group of entries in a state's tangent vector, such as the root's rotation."""

    name: str
    size: int
    joints: tuple[int, ...] = ()  # Pose columns that the block's rotation vectors rotate, three numbers each.


@dataclass(frozen=True)
class StateLayout:
    """Order of the tangent vector of a keyframe or frame: named blocks, with the joints' rotation vectors last."""

    blocks: tuple[Block, ...]

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, code_dof: int, num_joints: int, uncovered: tuple[int, ...] = ()) -> StateLayout:
        """Return the layout of a state that contains a prior's code.

        Args:
            code_dof: dimension of the code manifold.
            num_joints: number of joints after the root that rotate.
            uncovered: columns of the pose that the prior does not model.
        """
        covered = tuple(joint for joint in range(num_joints) if joint not in uncovered)
        turned = Block(UNCOVERED, 3 * len(uncovered), uncovered), Block(RESIDUAL, 3 * len(covered), covered)
        return cls((Block(CODE, code_dof), Block(ROOT, 3), Block(TRANSL, 3), *turned))

    def __contains__(self, name: str) -> bool:
        return name in self._slices

    def __getitem__(self, name: str) -> slice:
        """Return the tangent entries of a block. Raise ``KeyError`` if there is no such block."""
        return self._slices[name]

    def only(self, names: Collection[str]) -> StateLayout:
        """Return the layout with only the given blocks, in the order of this layout."""
        return StateLayout(tuple(block for block in self.blocks if block.name in names))

    def without(self, *names: str) -> StateLayout:
        """Return the layout without the given blocks."""
        return StateLayout(tuple(block for block in self.blocks if block.name not in names))

    def columns(self, free: Collection[str]) -> np.ndarray:
        """Return the (n,) tangent indices of the blocks named in ``free``, in the order of ``only(free)``."""
        return np.concatenate([np.arange(self.dof)[self[block.name]] for block in self.only(free).blocks])

    @cached_property
    def dof(self) -> int:
        """Number of entries in the tangent vector."""
        return sum(block.size for block in self.blocks)

    @cached_property
    def turned(self) -> tuple[int, ...]:
        """Pose columns of the joints that the state stores as rotation vectors, in the order of the blocks."""
        return tuple(joint for block in self.blocks for joint in block.joints)

    @property
    def turns(self) -> slice:
        """Tangent entries of the rotation vectors of the joints in ``turned``."""
        return slice(self.dof - 3 * len(self.turned), self.dof)

    @cached_property
    def _slices(self) -> dict[str, slice]:
        ends = np.cumsum([block.size for block in self.blocks]).tolist()
        return {block.name: slice(end - block.size, end) for block, end in zip(self.blocks, ends, strict=True)}
