"""An endless stream of spoiled marker clouds, made where the network trains and never written down."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from solver_backend.body.body import Body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS
from solver_backend.labelling.outputs import GHOST, JOINTS, MARKERS, other_side
from training.landmarks.body_points import PLACES, BodyPoints, rodrigues
from training.landmarks.corruption import Corruption
from training.landmarks.layout_masks import layout_masks, part_masks
from training.landmarks.thesis_corruption import ThesisCorruption, thesis_shapes

_LIMBS = (
    SMPL.group("left_arm"), SMPL.group("right_arm"), SMPL.both("hip", "knee", "ankle", "foot"),
    SMPL.numbers("neck", "head"),
)  # fmt: skip
"""Joints that travel together when poses exchange limbs."""


@dataclass(frozen=True)
class Clouds:
    """B clouds of up to N points, Z up, the median of the points at the origin, in metres."""

    points: torch.Tensor
    """(B, N, 3)."""
    seen: torch.Tensor
    """(B, N) bool: whether there is a point."""
    labels: torch.Tensor
    """(B, N) marker of each point, ``GHOST`` for none, -1 where there is no point."""
    targets: torch.Tensor
    """(B, 77, 3) markers and joints, seen or not."""
    weight: torch.Tensor
    """(B,) share of each sample in the loss."""


@dataclass(frozen=True)
class Variety:
    """How clouds differ besides their poses."""

    layouts: bool = True
    """Layouts and subsets of the superset; all 53 markers if False."""
    ghosts: bool = True
    """Points that are no markers."""
    noise: bool = True
    """Points off their places, and places that differ between people."""
    pose_noise: float = 0.05
    """Standard deviation of each joint's turn, rad."""
    exchanged: float = 0.1
    """Chance that a limb comes from another pose."""
    thinned: float = 0.35
    """Chance that a layout lacks up to half of its markers."""
    parts: float = 0.12
    """Chance that only a part of the body wears markers."""
    tilted: float = 0.12
    """Chance that the whole cloud is turned by up to 90° about a level axis."""
    wobble_rad: float = 0.05
    """Standard deviation of every cloud's lean."""
    headings: bool = True
    """People head anywhere; as they were recorded if False."""
    sizes: float = 0.12
    """People are scaled by up to this share."""
    strayed: bool = True
    """Markers are off their rules, by each place's spread."""
    thesis: bool = False
    """Shapes by 4.20 and 4.21, corruption by 4.22 to 4.27 alone, instead of ours."""


class CloudStream:
    """Draws clouds of given poses."""

    def __init__(self, body: Body, device: str, variety: Variety = Variety()) -> None:
        self.points = BodyPoints(body, device)
        self.device, self.variety = device, variety
        ours = Corruption(self.points.device, ghosts=variety.ghosts, noise=variety.noise)
        self.corruption = ThesisCorruption(self.points.device) if variety.thesis else ours
        self.layouts, self.layout_chance = layout_masks(device)
        self.parts = part_masks(self.points.weights)
        names = (*PLACES, *JOINTS)
        self.mirror = torch.tensor([names.index(other_side(name)) for name in names], device=device)
        self.flip = torch.tensor([-1.0, 1.0, 1.0], device=device)
        self.z_up = torch.tensor([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]], device=device)
        self.limbs = [torch.tensor(limb, device=device) for limb in _LIMBS]

    def draw(self, rotvec: torch.Tensor, weight: torch.Tensor | None = None) -> Clouds:
        """Return clouds of (B, 22, 3) poses, the pelvis first, Y up; all draws are from torch's own generator."""
        with torch.no_grad():
            places, joints = self._posed(rotvec)
            count = len(rotvec)
            worn = self._worn(count)
            cloud = self.corruption(places, worn)
            centre = _median(cloud.points, cloud.seen)
            targets = torch.cat((places[:, :GHOST], joints), 1) - centre
            ones = torch.ones(count, device=self.device) if weight is None else weight
            points = torch.where(cloud.seen[..., None], cloud.points - centre, 0.0)
            whole = Clouds(points, cloud.seen, cloud.labels, targets, ones)
            return whole if self.device == "cuda" else without_empty_slots(whole)

    def _posed(self, rotvec: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (B, P, 3) places and (B, 24, 3) joints, of people of all shapes, heading anywhere."""
        count, device, v = len(rotvec), self.device, self.variety
        rotations = rodrigues(rotvec)
        for limb in self.limbs:
            donor = rotations[torch.rand(count, device=device).argsort()]
            take = torch.rand(count, 1, 1, 1, device=device) < v.exchanged
            rotations[:, limb] = torch.where(take, donor[:, limb], rotations[:, limb])
        strength = v.pose_noise * torch.rand(count, 1, 1, device=device) * 1.6
        turn = rodrigues(strength * _normal(count, 1 + NUM_BODY_JOINTS, 3, like=rotvec))
        rotations = rotations @ turn
        betas = self._shapes(rotvec)
        places, joints = self.points(rotations[:, 0], rotations[:, 1:], betas, self.placement(count))
        everything = torch.cat((places, joints), 1)
        mirrored = (everything * self.flip)[:, self.mirror]
        everything = torch.where(_often(0.5, count, 1, 1, like=rotvec) > 0, mirrored, everything)
        everything = everything @ self._turns(count).transpose(1, 2)
        everything = everything * (1.0 - v.sizes + 2.0 * v.sizes * torch.rand(count, 1, 1, device=device))
        return everything[:, : len(PLACES)], everything[:, -NUM_JOINTS:]

    def _shapes(self, like: torch.Tensor) -> torch.Tensor:
        """Return (B, 10) shapes: the thesis' of a normal draw, as there are no recorded ones, or ours."""
        count, device = len(like), self.device
        betas = 0.7 * _normal(count, 10, like=like)
        if self.variety.thesis:
            return thesis_shapes(betas)
        betas = betas + _often(0.5, count, 1, like=like) * (2.0 * torch.rand(count, 1, device=device) - 1.0)
        return torch.where(torch.rand(count, 10, device=device) < 0.1, _normal(count, 10, like=like), betas)

    def placement(self, count: int) -> torch.Tensor:
        """Return (B, P, 3) metres by which each person's markers are off their rules, along the skin and off it."""
        b = self.points
        if not (self.variety.noise and self.variety.strayed):
            return torch.zeros(count, len(PLACES), 3, device=self.device)
        # Three quarters of a place's spread: rules stray by the spread between laboratories, not only by hands.
        along = _normal(count, len(PLACES), 3, like=b.spread).clamp(-2.0, 2.0) * b.spread[:, 1:]
        along = along - (along * b.normals).sum(-1, keepdim=True) * b.normals
        off = _normal(count, len(PLACES), 1, like=b.spread) * b.spread[:, :1] * b.normals
        return (0.2 + 0.8 * torch.rand(count, 1, 1, device=self.device)) * (0.75 * along + off)

    def _turns(self, count: int) -> torch.Tensor:
        """Return (B, 3, 3) rotations from Y up to Z up, any heading, some of them tilted."""
        device = self.device
        heading = 2.0 * torch.pi * torch.rand(count, device=device) * self.variety.headings
        axis = 2.0 * torch.pi * torch.rand(count, device=device)
        tilt = torch.where(
            torch.rand(count, device=device) < self.variety.tilted,
            0.5 * torch.pi * torch.rand(count, device=device),
            self.variety.wobble_rad * torch.randn(count, device=device),
        )  # fmt: skip
        zero = torch.zeros_like(heading)
        level = rodrigues(torch.stack((tilt * axis.cos(), tilt * axis.sin(), zero), -1))
        return level @ rodrigues(torch.stack((zero, zero, heading), -1)) @ self.z_up

    def _worn(self, count: int) -> torch.Tensor:
        """Return (B, P) bool: which places carry a marker."""
        device = self.device
        if not self.variety.layouts:
            worn = torch.zeros(count, len(PLACES), dtype=torch.bool, device=device)
            worn[:, : len(MARKERS)] = True
            return worn
        which = torch.searchsorted(self.layout_chance, torch.rand(count, device=device)).clamp(
            max=len(self.layouts) - 1
        )
        worn = self.layouts[which]
        kept = 0.5 + 0.5 * torch.rand(count, 1, device=device)
        thinned = torch.rand(count, len(PLACES), device=device) < kept
        worn = torch.where(_often(self.variety.thinned, count, 1, like=kept) > 0, worn & thinned, worn)
        part = self.parts[torch.randint(len(self.parts), (count,), device=device)]
        worn = torch.where(_often(self.variety.parts, count, 1, like=kept) > 0, worn & part, worn)
        more = torch.rand(count, len(PLACES), device=device) < 0.06 * torch.rand(count, 1, device=device)
        return torch.where(_often(0.25, count, 1, like=kept) > 0, worn | more, worn)


def without_empty_slots(clouds: Clouds) -> Clouds:
    """Return the clouds with the points that are there first, and no more slots than the fullest needs."""
    most = int(clouds.seen.sum(1).max())
    order = (~clouds.seen).to(torch.int8).argsort(dim=1, stable=True)[:, :most]
    points = clouds.points.gather(1, order[..., None].expand(-1, -1, 3))
    return Clouds(points, clouds.seen.gather(1, order), clouds.labels.gather(1, order), clouds.targets, clouds.weight)


def _median(points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Return the (B, 1, 3) lower medians of the points that are there."""
    ordered = torch.where(seen[..., None], points, torch.inf).sort(dim=1).values
    middle = ((seen.sum(1) - 1) // 2).clamp(min=0)
    return ordered.gather(1, middle[:, None, None].expand(-1, 1, 3))


def _normal(*shape: int, like: torch.Tensor) -> torch.Tensor:
    return torch.randn(*shape, device=like.device)


def _often(chance: float, *shape: int, like: torch.Tensor) -> torch.Tensor:
    return (torch.rand(*shape, device=like.device) < chance).float()
