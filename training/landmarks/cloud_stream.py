"""Endless stream of synthetic, corrupted marker clouds for training. They are computed on the training device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from solver_backend.body.body import Body
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_landmarks, skin_normals
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS
from solver_backend.labelling.outputs import GHOST, JOINTS, MARKERS, OTHER_PLACES, other_side

PLACES: tuple[str, ...] = (*MARKERS, *OTHER_PLACES)


def rodrigues(rotvec: torch.Tensor) -> torch.Tensor:
    """Return rotations ``exp([v]x)``, shape (..., 3, 3), for rotation vectors (..., 3)."""
    angle = (rotvec.square().sum(-1) + 1e-12).sqrt()[..., None, None]
    x, y, z = rotvec.unbind(-1)
    zero = torch.zeros_like(x)
    K = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    eye = torch.eye(3, device=rotvec.device, dtype=rotvec.dtype)
    return eye + (angle.sin() / angle) * K + ((1.0 - angle.cos()) / angle.square()) * (K @ K)


class BodyPoints:
    """Skinned marker positions and joints of a body, for B samples, P positions and J = 24 joints.

    ``y_l = sum_b w_lb p_b + G_b (a_lb + S_lb beta + w_lb o_l - w_lb J_b(beta)) + blend_l P_l f`` as in ``Landmarks``
    (Loper et al. 2015, eqs. 2-10). Each sample has its own shape and offsets o.
    """

    def __init__(self, body: Body, device: str) -> None:
        marks = marker_landmarks(body, PLACES)
        self.device = device
        self.levels = [tuple(torch.tensor(x, device=device) for x in level) for level in _levels(body.parents)]
        self.parents = body.parents
        self.weights = self._tensor(marks.weights)
        self.anchors = self._tensor(marks.anchors)
        self.shapedirs = self._tensor(marks.shapedirs.reshape(-1, marks.shapedirs.shape[-1]).T)
        assert marks.posedirs is not None
        self.posedirs = self._tensor(marks.posedirs.reshape(-1, marks.posedirs.shape[-1]).T)
        self.joints = self._tensor(body.joints_template)
        self.joint_shapes = self._tensor(body.joints_shapedirs.reshape(-1, body.joints_shapedirs.shape[-1]).T)
        self.normals = self._tensor(skin_normals(body, PLACES))
        spread = np.array([load_layouts().spread_of(name) for name in PLACES])
        self.spread = self._tensor(spread)
        """(P, 2) standard deviation of marker positions from their rules in metres, off the skin and along it."""

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array, dtype=np.float32), device=self.device)

    def __call__(
        self, root: torch.Tensor, local: torch.Tensor, betas: torch.Tensor, offsets: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (B, P, 3) markers and (B, 24, 3) joints in metres, in the rest frame, with the pelvis at rest height.

        Args:
            root: (B, 3, 3) rotations of the pelvis.
            local: (B, 21, 3, 3) local rotations of the body joints.
            betas: (B, 10) shapes.
            offsets: (B, P, 3) marker offsets in metres in the rest frame.
        """
        count, places = len(root), len(PLACES)
        rest = self.joints + (betas @ self.joint_shapes).unflatten(-1, (-1, 3))
        G, joints = self._posed(root, local, rest)
        levers = self.anchors + (betas @ self.shapedirs).view(count, places, -1, 3)
        levers = levers + self.weights[..., None] * (offsets[:, :, None] - rest[:, None])
        flat = G.permute(0, 2, 1, 3).reshape(count, 3, -1)
        points = torch.bmm(levers.view(count, places, -1), flat.transpose(1, 2))
        points = points + torch.matmul(self.weights, joints)
        eye = torch.eye(3, device=root.device)
        feature = torch.cat(((local - eye).flatten(1), torch.zeros(count, 18, device=root.device)), 1)
        correction = (feature @ self.posedirs).unflatten(-1, (places, 3))
        blend = torch.matmul(self.weights, G.flatten(2)).unflatten(-1, (3, 3))
        return points + (blend @ correction[..., None])[..., 0], joints

    def _posed(self, root: torch.Tensor, local: torch.Tensor, rest: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return global rotations (B, 24, 3, 3) and joints (B, 24, 3), one level of the tree after another."""
        count = len(root)
        hands = torch.eye(3, device=root.device).expand(count, 2, 3, 3)
        local = torch.cat((root[:, None], local, hands), 1)
        G, joints = local.clone(), rest.clone()
        for children, parents in self.levels:
            G[:, children] = G[:, parents] @ local[:, children]
            step = (G[:, parents] @ (rest[:, children] - rest[:, parents])[..., None])[..., 0]
            joints[:, children] = joints[:, parents] + step
        return G, joints


def _levels(parents: tuple[int, ...]) -> list[tuple[list[int], list[int]]]:
    """Return the joints at each distance from the root, and their parents."""
    depth = [0] * len(parents)
    for joint, parent in enumerate(parents):
        depth[joint] = 0 if parent < 0 else depth[parent] + 1
    levels = [[j for j in range(len(parents)) if depth[j] == d] for d in range(1, max(depth) + 1)]
    return [(level, [parents[j] for j in level]) for level in levels]


OTHERS, FREE, PROP = 10, 4, 6
"""Largest numbers of points at other layouts' marker positions, of ghost points, and of points on a prop."""


@dataclass(frozen=True)
class SpoiledClouds:
    """B corrupted clouds with N slots: 53 markers, 10 points of other layouts, 4 ghosts and 6 points of a prop."""

    points: torch.Tensor  # (B, N, 3) points in metres.
    seen: torch.Tensor  # (B, N) mask of slots that contain a point.
    labels: torch.Tensor  # (B, N) marker of each point, or -1 if there is no point.


@dataclass(frozen=True)
class Corruption:
    """Adds occlusion (thesis 4.22-4.24), ghosts (4.25), noise (4.26, 4.27), points of other layouts, and a prop."""

    device: str
    ghosts: bool = True
    noise: bool = True
    most_hidden: int = 10  # n' in 4.23.
    displacement_m: float = 0.02  # M_noise in 4.26.
    hidden_chance: float = 0.7
    ghost_chance: float = 0.6
    noise_chance: float = 0.8
    prop_chance: float = 0.08

    def __call__(self, places: torch.Tensor, worn: torch.Tensor) -> SpoiledClouds:
        """Return corrupted clouds of positions (B, P, 3). ``worn`` (B, P) marks positions that have a marker."""
        count, device = len(places), self.device
        seen = worn[:, :GHOST] & ~self._hidden(worn[:, :GHOST])
        points = places[:, :GHOST]
        if self.noise:
            points = points + self._displaced(points)
        labels = torch.where(seen, torch.arange(GHOST, device=device), -1)
        if not self.ghosts:
            return SpoiledClouds(points, seen, labels)
        chosen = (worn[:, GHOST:] * (1.0 + torch.rand(count, len(PLACES) - GHOST, device=device))).topk(OTHERS, dim=1)
        others = places[:, GHOST:].gather(1, chosen.indices[..., None].expand(-1, -1, 3))
        free, there = self._free(points, seen)
        prop, held = self._prop(points)
        more = torch.cat((chosen.values > 0.5, there, held), 1)
        return SpoiledClouds(
            torch.cat((points, others, free, prop), 1),
            torch.cat((seen, more), 1),
            torch.cat((labels, torch.where(more, GHOST, -1)), 1),
        )

    def _hidden(self, worn: torch.Tensor) -> torch.Tensor:
        """Return a mask (B, 53) of k hidden markers, where k is uniform. At least one marker remains visible."""
        count = len(worn)
        rank = torch.where(worn, torch.rand(worn.shape, device=self.device), 2.0).argsort(1).argsort(1)
        k = torch.randint(self.most_hidden + 1, (count, 1), device=self.device)
        k = torch.minimum(k, worn.sum(1, keepdim=True) - 1)
        return (rank < k) & (torch.rand(count, 1, device=self.device) < self.hidden_chance)

    def _displaced(self, points: torch.Tensor) -> torch.Tensor:
        """Return offsets inside a cube for some points, and noise of a few millimetres for all points."""
        shape = points.shape[:2]
        share = torch.rand(shape[0], 1, device=self.device)
        moved = (torch.rand(shape, device=self.device) < 0.6 * share)[..., None]
        moved = moved & (torch.rand(shape[0], 1, 1, device=self.device) < self.noise_chance)
        cube = self.displacement_m * (2.0 * torch.rand(points.shape, device=self.device) - 1.0)
        return torch.where(moved, cube, 0.0) + 0.001 * torch.randn(points.shape, device=self.device)

    def _free(self, points: torch.Tensor, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return ghosts (B, 4, 3) and their mask. Each is near a marker or from the Gaussian of the visible points."""
        count, device = len(points), self.device
        gaussian = self.gaussian(points, seen)
        beside = points[:, torch.randint(points.shape[1], (FREE,), device=device)]
        reach = 0.03 + 0.2 * torch.rand(count, FREE, 1, device=device)
        beside = beside + reach * torch.nn.functional.normalize(torch.randn(count, FREE, 3, device=device), dim=-1)
        ghosts = torch.where(torch.rand(count, FREE, 1, device=device) < 0.35, beside, gaussian)
        there = torch.arange(FREE, device=device) < torch.randint(1, FREE + 1, (count, 1), device=device)
        return ghosts, there & (torch.rand(count, 1, device=device) < self.ghost_chance)

    def gaussian(self, points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        """Draw ghosts (B, 4, 3) from a Gaussian with the visible points' mean and 1.2 times their deviations (4.25).

        Sums of the centred points with standard normal weights have the sample covariance.
        """
        share = seen[..., None].float()
        number = share.sum(1, keepdim=True).clamp(min=2.0)
        mean = (points * share).sum(1, keepdim=True) / number
        draw = torch.randn(len(points), FREE, points.shape[1], device=self.device) @ ((points - mean) * share)
        return mean + 1.2 * draw / (number - 1.0).sqrt()

    def _prop(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return points (B, 6, 3) on a stick or box near one of the markers, and a mask of the points that exist."""
        count, device = len(points), self.device
        near = points.gather(1, torch.randint(points.shape[1], (count, 1, 1), device=device).expand(-1, -1, 3))
        longest = torch.arange(3, device=device) == 0
        size = (0.08 + 0.42 * longest) * (0.5 + torch.rand(count, 1, 1, device=device))
        shape = size * (2.0 * torch.rand(count, PROP, 3, device=device) - 1.0)
        frame = torch.nn.functional.normalize(torch.randn(count, 3, 3, device=device), dim=-1)
        there = torch.arange(PROP, device=device) < torch.randint(2, PROP + 1, (count, 1), device=device)
        return near + shape @ frame, there & (torch.rand(count, 1, device=device) < self.prop_chance)


_CHANCES = {"MANIFOLD_53": 0.28, "CMU_41": 0.18, "PLUGIN_GAIT_39": 0.18}
"""Probability of each of these layouts. Layouts of other systems share the remaining probability."""


def layout_masks(device: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a mask (layouts, P) of the positions in each layout, and the layouts' cumulative probabilities."""
    file = load_layouts()
    masks, chances = [], []
    rest = (1.0 - sum(_CHANCES.values())) / len(file.label_sets)
    for name, labels in (*file.layouts.items(), *file.label_sets.items()):
        filled = {file.place_of(label) for label in labels}
        masks.append([place in filled for place in PLACES])
        chances.append(_CHANCES.get(name, rest))
    cumulated = torch.tensor(np.cumsum(chances), dtype=torch.float32, device=device)
    return torch.tensor(masks, device=device), cumulated


_HIPS, _LEGS = SMPL.both("hip"), SMPL.both("knee", "ankle", "foot")
_HANDS, _ARMS = SMPL.both("wrist", "hand"), SMPL.both("shoulder", "elbow", "wrist", "hand")
_EVERY = range(SMPL.num_joints)
_LEFT = (*SMPL.group("left_leg"), *SMPL.group("left_arm"), *SMPL.group("left_hand"))
PARTS = tuple(
    tuple(joint for joint in _EVERY if joint not in lacking)
    for lacking in (
        {joint for joint in _EVERY if joint not in (0, *_HIPS, *_LEGS)},
        {*_HIPS, *_LEGS},
        set(SMPL.numbers("neck", "head")),
        {*SMPL.both("collar"), *_ARMS},
        set(_HANDS),
        set(_LEFT),
    )
)
"""Joints of people who wear markers on a part of the body: legs, no legs, no head, no arms, no hands, one side."""


def part_masks(weights: torch.Tensor) -> torch.Tensor:
    """Return a mask (parts, P) of the positions in each of ``PARTS``, based on the largest of their weights (P, 24)."""
    joint = weights.argmax(1)
    return torch.stack([torch.isin(joint, torch.tensor(part, device=joint.device)) for part in PARTS])


DOMINANT = 3  # Number of leading shape coefficients that 4.21 may replace.


def thesis_shapes(betas: torch.Tensor, shift_chance: float = 0.5, redraw_chance: float = 0.5) -> torch.Tensor:
    """Shift all coefficients of shapes (B, 10) by one number, and redraw up to three of the first ones.

    These augmentations (thesis 4.20 and 4.21) are each applied to half of the samples, as in the paper.
    """
    count, device = len(betas), betas.device
    shift = (2.0 * torch.rand(count, 1, device=device) - 1.0) * (torch.rand(count, 1, device=device) < shift_chance)
    number = torch.randint(DOMINANT + 1, (count, 1), device=device)
    anew = torch.rand(count, DOMINANT, device=device).argsort(1).argsort(1) < number
    anew = anew & (torch.rand(count, 1, device=device) < redraw_chance)
    shifted = betas + shift
    first = torch.where(anew, torch.randn(count, DOMINANT, device=device), shifted[:, :DOMINANT])
    return torch.cat((first, shifted[:, DOMINANT:]), 1)


@dataclass(frozen=True)
class ThesisCorruption:
    """Adds occlusion (4.22 to 4.24), ghosts from the other markers' Gaussian (4.25) and bounded offsets (4.26, 4.27).

    The equations are from the thesis, and the probabilities from the paper. The numbers of hidden markers and ghosts
    and the size of the offsets are chosen by hand, because thesis and paper do not state them.
    """

    device: str
    least_hidden: int = 0  # m in 4.23.
    most_hidden: int = 10  # n' in 4.23.
    most_ghosts: int = 4  # n_ghost in 4.25 is uniform from 1 to this.
    displacement_m: float = 0.02  # M_noise in 4.26.
    hidden_chance: float = 0.7
    ghost_chance: float = 0.7
    noise_chance: float = 0.8

    def __call__(self, places: torch.Tensor, worn: torch.Tensor) -> SpoiledClouds:
        """Return corrupted clouds of positions (B, P, 3).

        ``worn`` (B, P) marks positions that have a marker. Ghosts follow after the 53 markers.
        """
        points, seen = places[:, :GHOST], worn[:, :GHOST]
        seen = seen & ~(self._chosen(seen, self.least_hidden, self.most_hidden) & self._at(self.hidden_chance, points))
        ghosts = self.ghosts(points, seen)
        number = torch.randint(1, self.most_ghosts + 1, (len(points), 1), device=self.device)
        there = (torch.arange(self.most_ghosts, device=self.device) < number) & self._at(self.ghost_chance, points)
        moved = self._chosen(torch.ones_like(seen), 1, GHOST) & self._at(self.noise_chance, points)
        offset = self.displacement_m * (2.0 * torch.rand(points.shape, device=self.device) - 1.0)
        labels = torch.where(seen, torch.arange(GHOST, device=self.device), -1)
        return SpoiledClouds(
            torch.cat((points + torch.where(moved[..., None], offset, 0.0), ghosts), 1),
            torch.cat((seen, there), 1),
            torch.cat((labels, torch.where(there, GHOST, -1)), 1),
        )

    def ghosts(self, points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        """Draw ghosts (B, G, 3) from a Gaussian with the other markers' median and covariance (4.25).

        Sums of the centred points with standard normal weights have the sample covariance.
        """
        share = seen[..., None].float()
        number = share.sum(1, keepdim=True).clamp(min=2.0)
        median = torch.where(seen[..., None], points, torch.nan).nanquantile(0.5, dim=1, keepdim=True)
        centred = (points - (points * share).sum(1, keepdim=True) / number) * share
        normal = torch.randn(len(points), self.most_ghosts, points.shape[1], device=self.device)
        return median + normal @ centred / (number - 1.0).sqrt()

    def _chosen(self, among: torch.Tensor, least: int, most: int) -> torch.Tensor:
        """Return a mask (B, n) of k elements of ``among``, where k is uniform from ``least`` to ``most``."""
        rank = torch.where(among, torch.rand(among.shape, device=self.device), 2.0).argsort(1).argsort(1)
        return rank < torch.randint(least, most + 1, (len(among), 1), device=self.device)

    def _at(self, chance: float, like: torch.Tensor) -> torch.Tensor:
        """Return a mask (B, 1) of the samples to corrupt, with probability ``chance``."""
        return torch.rand(len(like), 1, device=self.device) < chance


_LIMBS = (
    SMPL.group("left_arm"),
    SMPL.group("right_arm"),
    SMPL.both("hip", "knee", "ankle", "foot"),
    SMPL.numbers("neck", "head"),
)
"""Joints that move together when limbs are exchanged between poses."""


@dataclass(frozen=True)
class Clouds:
    """B clouds of up to N points in metres, Z up, with their median at the origin."""

    points: torch.Tensor  # (B, N, 3) points in metres.
    seen: torch.Tensor  # (B, N) mask of the points that exist.
    labels: torch.Tensor  # (B, N) marker of each point, or ``GHOST``, or -1 if there is no point.
    targets: torch.Tensor  # (B, 77, 3) markers and joints in metres, whether or not they are seen.
    weight: torch.Tensor  # (B,) weight of each sample in the loss.


@dataclass(frozen=True)
class Variety:
    """Settings for the random variations of marker clouds, apart from the poses."""

    layouts: bool = True  # Use layouts and subsets of the superset. If False, use all 53 markers.
    ghosts: bool = True  # Add points that are not markers.
    noise: bool = True  # Add noise to points, and vary marker positions between people.
    pose_noise: float = 0.05  # Standard deviation of each joint's rotation in rad.
    exchanged: float = 0.1  # Probability that a limb comes from another pose.
    thinned: float = 0.35  # Probability that up to half of a layout's markers are missing.
    parts: float = 0.12  # Probability that only a part of the body has markers.
    tilted: float = 0.12  # Probability that the cloud is rotated by up to 90° about a horizontal axis.
    wobble_rad: float = 0.05  # Standard deviation of the tilt of every cloud.
    headings: bool = True  # Give people random headings.
    sizes: float = 0.12  # Largest relative change of people's size.
    strayed: bool = True  # Displace each marker from where its rule puts it, with its own standard deviation.
    thesis: bool = False  # Use only shapes by 4.20 and 4.21, and only corruption by 4.22 to 4.27.


class CloudStream:
    """Makes random corrupted marker clouds from given poses."""

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
        """Return clouds for poses (B, 22, 3), pelvis first, Y up. All draws use torch's global generator."""
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
        """Return positions (B, P, 3) and joints (B, 24, 3) of people who have random shapes and headings."""
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
        """Draw normal shapes (B, 10), and shift or redraw coefficients as in the thesis or in our own way."""
        count, device = len(like), self.device
        betas = 0.7 * _normal(count, 10, like=like)
        if self.variety.thesis:
            return thesis_shapes(betas)
        betas = betas + _often(0.5, count, 1, like=like) * (2.0 * torch.rand(count, 1, device=device) - 1.0)
        return torch.where(torch.rand(count, 10, device=device) < 0.1, _normal(count, 10, like=like), betas)

    def placement(self, count: int) -> torch.Tensor:
        """Draw the markers' offsets (B, P, 3) in metres from their standard positions, along and off the skin."""
        b = self.points
        if not (self.variety.noise and self.variety.strayed):
            return torch.zeros(count, len(PLACES), 3, device=self.device)
        # Three quarters of a marker's deviation, because laboratories place markers differently.
        along = _normal(count, len(PLACES), 3, like=b.spread).clamp(-2.0, 2.0) * b.spread[:, 1:]
        along = along - (along * b.normals).sum(-1, keepdim=True) * b.normals
        off = _normal(count, len(PLACES), 1, like=b.spread) * b.spread[:, :1] * b.normals
        return (0.2 + 0.8 * torch.rand(count, 1, 1, device=self.device)) * (0.75 * along + off)

    def _turns(self, count: int) -> torch.Tensor:
        """Return rotations (B, 3, 3) from Y up to Z up with random headings. Some of them are tilted."""
        device = self.device
        heading = 2.0 * torch.pi * torch.rand(count, device=device) * self.variety.headings
        axis = 2.0 * torch.pi * torch.rand(count, device=device)
        tilt = torch.where(
            torch.rand(count, device=device) < self.variety.tilted,
            0.5 * torch.pi * torch.rand(count, device=device),
            self.variety.wobble_rad * torch.randn(count, device=device),
        )
        zero = torch.zeros_like(heading)
        level = rodrigues(torch.stack((tilt * axis.cos(), tilt * axis.sin(), zero), -1))
        return level @ rodrigues(torch.stack((zero, zero, heading), -1)) @ self.z_up

    def _worn(self, count: int) -> torch.Tensor:
        """Draw the positions that have a marker, as a mask (B, P)."""
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
    """Move all points to the first slots, and remove slots that no cloud needs."""
    most = int(clouds.seen.sum(1).max())
    order = (~clouds.seen).to(torch.int8).argsort(dim=1, stable=True)[:, :most]
    points = clouds.points.gather(1, order[..., None].expand(-1, -1, 3))
    return Clouds(points, clouds.seen.gather(1, order), clouds.labels.gather(1, order), clouds.targets, clouds.weight)


def _median(points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Return the lower medians (B, 1, 3) of the points that exist."""
    ordered = torch.where(seen[..., None], points, torch.inf).sort(dim=1).values
    middle = ((seen.sum(1) - 1) // 2).clamp(min=0)
    return ordered.gather(1, middle[:, None, None].expand(-1, 1, 3))


def _normal(*shape: int, like: torch.Tensor) -> torch.Tensor:
    return torch.randn(*shape, device=like.device)


def _often(chance: float, *shape: int, like: torch.Tensor) -> torch.Tensor:
    return (torch.rand(*shape, device=like.device) < chance).float()
