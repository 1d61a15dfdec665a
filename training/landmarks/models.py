"""Landmark networks to compare. Each estimates landmark positions, and has a loss on a batch of clouds."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any, Literal

import torch
from torch import nn
from torch.nn import functional
from torch.nn.functional import cross_entropy

from solver_backend.labelling.outputs import GHOST, JOINTS, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import FREQUENCIES, NEARNESS, NEARNESS_WIDTH
from training.engine.dense_layers import AttentionLayer, attention, split_heads
from training.landmarks.cloud_stream import Clouds

SIZE = 160  # Width and height of a map in pixels.
MARGIN = 1.25
"""Half the width of a map relative to half the extent of the cloud. The margin leaves space for hidden hands."""
_RADIUS = 1
_THINNEST = 1e-3
"""Smallest extent of a cloud in metres. It avoids a division by zero."""


@dataclass(frozen=True)
class CanvasFrame:
    """Transformation from normalised coordinates to metres: ``metres = centre + half * normalised``."""

    centre: torch.Tensor  # (B, 1, 3) centre of the cloud.
    half: torch.Tensor  # (B, 1, 1) half the size of the cloud.

    def normalised(self, points: torch.Tensor) -> torch.Tensor:
        """Convert points in metres to normalised coordinates from -1 to 1."""
        return (points - self.centre) / self.half

    def metres(self, points: torch.Tensor) -> torch.Tensor:
        """Convert normalised points to metres."""
        return self.centre + self.half * points


def y_up(points: torch.Tensor) -> torch.Tensor:
    """Convert points from Z up to Y up, the axes of the published network."""
    return torch.stack((points[..., 0], points[..., 2], -points[..., 1]), -1)


def frame_of(points: torch.Tensor, seen: torch.Tensor) -> CanvasFrame:
    """Return the frame of Y-up clouds: the centre of the bounding box, and its extent with a margin."""
    low, high = _box(points, seen)
    return CanvasFrame(0.5 * (low + high), MARGIN * 0.5 * (high - low).amax(-1, keepdim=True).clamp(min=0.2))


def depth_maps(points: torch.Tensor, seen: torch.Tensor, size: int = SIZE) -> torch.Tensor:
    """Return xy and yz views (B, 2, size, size) of normalised points (B, N, 3), with rows along y.

    The second view looks along +x, so z increases to the right. One network reads both views, so a mirrored view would
    make left and right ambiguous. A marker covers 3 x 3 pixels. Their value is the marker's nearness to the viewer,
    from 0.1 for the cloud's farthest point to 1. If markers overlap, only the nearest one is visible.
    """
    near = _nearness(points, seen)
    xy = _splatted(points[..., 0], points[..., 1], 0.1 + 0.9 * near[..., 2], seen, size)
    yz = _splatted(points[..., 2], points[..., 1], 1.0 - 0.9 * near[..., 0], seen, size)
    return torch.stack((xy, yz), 1)


def front_and_back(points: torch.Tensor, seen: torch.Tensor, size: int = SIZE) -> torch.Tensor:
    """Return xy views (B, 2, size, size) from the front and from the back, as in Democap's network."""
    z = 0.9 * _nearness(points, seen)[..., 2]
    front = _splatted(points[..., 0], points[..., 1], 0.1 + z, seen, size)
    back = _splatted(points[..., 0], points[..., 1], 1.0 - z, seen, size)
    return torch.stack((front, back), 1)


def _nearness(points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Scale positions (B, N, 3) to 0..1 within the bounding box of each cloud's visible points."""
    low, high = _box(points, seen)
    return ((points - low) / (high - low).clamp(min=_THINNEST)).clamp(0.0, 1.0)


def _box(points: torch.Tensor, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the minimum and maximum coordinates of the visible points, each (B, 1, 3)."""
    low = torch.where(seen[..., None], points, torch.inf).amin(1, keepdim=True)
    return low, torch.where(seen[..., None], points, -torch.inf).amax(1, keepdim=True)


def _splatted(u: torch.Tensor, v: torch.Tensor, value: torch.Tensor, seen: torch.Tensor, size: int) -> torch.Tensor:
    """Return maps (B, size, size) of the largest value among the points that cover a pixel, or 0 without points."""
    device = u.device
    around = torch.arange(-_RADIUS, _RADIUS + 1, device=device)
    columns = ((u + 1.0) * 0.5 * (size - 1)).round().long()[..., None, None] + around
    rows = ((v + 1.0) * 0.5 * (size - 1)).round().long()[..., None, None] + around[:, None]
    columns, rows = torch.broadcast_tensors(columns, rows)
    inside = (columns >= 0) & (columns < size) & (rows >= 0) & (rows < size) & seen[..., None, None]
    index = (rows.clamp(0, size - 1) * size + columns.clamp(0, size - 1)).flatten(1)
    values = torch.where(inside, value[..., None, None], 0.0).flatten(1)
    maps = torch.zeros(u.shape[0], size * size, device=device)  # len() would become a constant in ONNX
    return maps.scatter_reduce(1, index, values, "amax").unflatten(1, (size, size))


def drawn(clouds: Clouds) -> tuple[torch.Tensor, torch.Tensor, CanvasFrame, torch.Tensor]:
    """Convert clouds to Y up. Return normalised points, the mask ``seen``, the frame and the normalised targets."""
    points = y_up(clouds.points)
    frame = frame_of(points, clouds.seen)
    return frame.normalised(points), clouds.seen, frame, frame.normalised(y_up(clouds.targets))


SIGMA_PX = 2.0  # Standard deviation of the heatmaps that networks learn, in pixels.
SKIPPED = 2  # Using every second pixel along each axis changes the centre by less than 0.8 mm.
REACH_SIGMAS = 4.5  # Radius of a Gaussian in standard deviations. Values beyond it are negligible.
WELSCH_NU = 0.05  # Scale of Welsch's loss for normalised positions. Chosen by hand.
HEAT_SHARE, WELSCH_SHARE = 1.0, 1.0


def _profile(where: torch.Tensor, size: int) -> torch.Tensor:
    """Return Gaussian profiles (..., size) along one axis. Each sums to 1."""
    pixels = torch.linspace(-1.0, 1.0, size, device=where.device)
    sigma = 2.0 * SIGMA_PX / (size - 1)
    return torch.softmax(-0.5 * ((pixels - where.clamp(-1.0, 1.0)[..., None]) / sigma).square(), -1)


@dataclass(frozen=True)
class MapReading:
    """Values read from heatmaps (the softmax of logits (..., S, S)) without computing the heatmaps."""

    across: torch.Tensor  # (...) centre of mass in x, in -1..1.
    down: torch.Tensor  # (...) centre of mass in y, in -1..1.
    log_total: torch.Tensor  # (...) logarithm of the sum of exponentials. It normalises the logits.
    log_near: torch.Tensor  # (..., n) logarithms of the heatmaps at the given pixels.


def read_maps(logits: torch.Tensor, pixels: torch.Tensor | None = None, line: torch.Tensor | None = None) -> MapReading:
    """Read the centres of heatmaps from their logits, and the heatmaps' logarithms at some pixels.

    Args:
        logits: (..., S, S) logits of the heatmaps.
        pixels: (..., n) pixel indices, counted along rows.
        line: (S,) coordinates of rows and columns, or None for equal steps over -1..1.
    """
    side, shape = logits.shape[-1], logits.shape[:-2]
    flat = logits.reshape(-1, side * side)
    index = flat.new_empty((len(flat), 0), dtype=torch.long) if pixels is None else pixels.reshape(len(flat), -1)
    line = torch.linspace(-1.0, 1.0, side, device=logits.device) if line is None else line
    v, u = torch.meshgrid(line, line, indexing="ij")
    basis = torch.stack((torch.ones_like(u), u, v), -1).flatten(0, 1)
    log_total, centre, near = _SoftmaxReading.apply(flat, index, basis)
    across, down = centre.unflatten(0, shape).unbind(-1)
    return MapReading(across, down, log_total.view(shape), (near - log_total[:, None]).unflatten(0, shape))


class _SoftmaxReading(torch.autograd.Function):
    """Compute the total, centre and some values of a softmax in one pass, and their derivatives in a second pass.

    If ``h = softmax(l)``, then ``d log_total / dl = h`` and ``d c / dl = h (x - c)``.
    """

    @staticmethod
    def forward(
        ctx: Any, logits: torch.Tensor, index: torch.Tensor, basis: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        with torch.autocast(logits.device.type, enabled=False):
            logits = logits.float()
            highest = logits.amax(-1, keepdim=True)
            mass = (logits - highest).exp_()
            sums = mass @ basis
            total, centre = sums[:, :1], sums[:, 1:] / sums[:, :1]
            ctx.save_for_backward(mass, total, centre, index, basis)
            return (highest + total.log())[:, 0], centre, logits.gather(-1, index)

    @staticmethod
    def symbolic(graph: Any, logits: Any, index: Any, basis: Any) -> tuple[Any, Any, Any]:
        """Return the values of ``forward``, computed by operators of an ONNX file (opset 18)."""
        last, of_places = (graph.op("Constant", value_t=torch.tensor(which)) for which in ([-1], [1, 2]))
        sums = graph.op("MatMul", graph.op("Softmax", logits, axis_i=-1), basis)
        return (
            graph.op("ReduceLogSumExp", logits, last, keepdims_i=0),
            graph.op("Gather", sums, of_places, axis_i=1),
            graph.op("GatherElements", logits, index, axis_i=1),
        )

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        by_total, by_centre, by_near = gradients
        mass, total, centre, index, basis = ctx.saved_tensors
        constant = by_total[:, None] - (by_centre * centre).sum(-1, keepdim=True)
        by_logits = torch.cat((constant, by_centre), -1).div_(total) @ basis.T
        return by_logits.mul_(mass).scatter_add_(-1, index, by_near), None, None


def fused(reading: MapReading) -> torch.Tensor:
    """Fuse readings (B, 2, L) of the xy and yz views into normalised positions (B, L, 3). y is averaged."""
    across, down = reading.across, reading.down
    return torch.stack((across[:, 0], 0.5 * (down[:, 0] + down[:, 1]), across[:, 1]), -1)


def gaussians_near(u: torch.Tensor, v: torch.Tensor, size: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the non-zero values (..., n) of Gaussians around (...) coordinates, and their pixel indices (..., n)."""
    side = min(size, 2 * math.ceil(REACH_SIGMAS * SIGMA_PX) + 1)
    around = torch.arange(side, device=u.device)
    columns, rows = (
        ((c.clamp(-1.0, 1.0) + 1.0) * 0.5 * (size - 1) - side // 2).round().long().clamp(0, size - side)[..., None]
        + around
        for c in (u, v)
    )
    down, across = _profile(v, size).gather(-1, rows), _profile(u, size).gather(-1, columns)
    a = (down[..., :, None] * across[..., None, :]).flatten(-2)
    return a, (size * rows[..., :, None] + columns[..., None, :]).flatten(-2)


def divergence_from_gaussians(gaussians: torch.Tensor, log_near: torch.Tensor) -> torch.Tensor:
    """Return the Jensen-Shannon divergence (...) of maps from Gaussians, evaluated near the Gaussians.

    It equals the divergence of the whole maps, except for the parts of Gaussians beyond ``REACH_SIGMAS``. If one map is
    0 at a pixel, the mass of the other counts ``log(2) / 2``.
    """
    a, b = gaussians, log_near.exp()
    log_middle = (0.5 * (a + b) + 1e-12).log()
    near = a * ((a + 1e-12).log() - log_middle) + b * ((b + 1e-12).log() - log_middle)
    return 0.5 * (near.sum(-1) + math.log(2.0) * (2.0 - a.sum(-1) - b.sum(-1)))


def relative_entropy(gaussians: torch.Tensor, log_near: torch.Tensor) -> torch.Tensor:
    """Return the relative entropy ``KL(G || H) = sum G (log G - log H)``, shape (...), evaluated near the Gaussians.

    G are the Gaussians and H the heatmaps. The gradient w.r.t. a logit is ``H - G``. The Jensen-Shannon gradient is
    ``H (log(H / M) - JS) / 2`` with the mean map M. This gradient is zero for a map that is confidently wrong.
    """
    return (gaussians * ((gaussians + 1e-12).log() - log_near)).sum(-1)


def welsch(truth: torch.Tensor, estimate: torch.Tensor) -> torch.Tensor:
    """Return Welsch's robust loss ``1 - exp(-|e|² / 2 ν²)`` of normalised positions (..., 3) (thesis eq. 4.15)."""
    return 1.0 - torch.exp(-(truth - estimate).square().sum(-1) / (2.0 * WELSCH_NU**2))


BLOCKS = 5  # Number of resolutions, each half of the previous one. Chosen by hand.


class UNet(nn.Module):
    """Convolutional network (U-Net) from input maps to output maps of the same size.

    Blocks have ``width * (1, 2, 4, 8, 16)`` features and two 3 x 3 convolutions each, with ReLU before batch
    normalisation as in the paper. The width in the paper is 32.
    """

    def __init__(self, inputs: int, outputs: int, width: int = 32) -> None:
        super().__init__()
        widths = [width * 2**k for k in range(BLOCKS)]
        self.encoders = nn.ModuleList(
            _ConvolutionBlock(a, b) for a, b in zip([inputs, *widths[:-1]], widths, strict=True)
        )
        self.bottleneck = _ConvolutionBlock(widths[-1], widths[-1], convolutions=1)
        self.decoders = nn.ModuleList(
            _ConvolutionBlock(below + own, own) for below, own in zip(widths[:0:-1], widths[-2::-1], strict=True)
        )
        self.predict = nn.Conv2d(widths[0], outputs, 1)
        self.pools = nn.ModuleList(_SmoothPool(b) for b in widths[:-1])
        self.to(memory_format=torch.channels_last)  # pyrefly: ignore[no-matching-overload]

    def forward(self, maps: torch.Tensor, every: int = 1) -> torch.Tensor:
        """Map (B, inputs, H, W) to (B, outputs, H, W) at every ``every``-th pixel. H and W must be divisible by 16."""
        kept = []
        x = maps
        for number, encoder in enumerate(self.encoders):
            x = encoder(x)
            if number < len(self.pools):
                kept.append(x)
                x = self.pools[number](x)
        x = self.bottleneck(x)
        for decoder, same in zip(self.decoders, reversed(kept), strict=True):
            x = functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
            x = decoder(torch.cat((x, same), 1))
        with torch.autocast(x.device.type, enabled=False):
            return self._predicted(x[..., ::every, ::every].float())

    def _predicted(self, x: torch.Tensor) -> torch.Tensor:
        """Return the maps of the prediction layer, each contiguous in memory.

        They are computed as a matrix product, because they are used one at a time.
        """
        weight, bias = self.predict.weight.flatten(1), self.predict.bias
        assert bias is not None
        maps = torch.baddbmm(bias[None, :, None], weight.expand(x.shape[0], -1, -1), x.flatten(2))
        return maps.unflatten(2, x.shape[2:])


class _ConvolutionBlock(nn.Sequential):
    def __init__(self, inputs: int, outputs: int, convolutions: int = 2) -> None:
        layers: list[nn.Module] = []
        for number in range(convolutions):
            layers += [
                nn.Conv2d(outputs if number else inputs, outputs, 3, padding=1),
                nn.ReLU(),
                nn.BatchNorm2d(outputs),
            ]
        super().__init__(*layers)


class _SmoothPool(nn.Module):
    """Maximum over 2 x 2 pixels, then a binomial filter, then every second pixel (Zhang 2019)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        row = torch.tensor([1.0, 2.0, 1.0]) / 4.0
        self.channels = channels
        self.register_buffer("kernel", (row[:, None] * row).expand(channels, 1, 3, 3).clone(), persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = functional.max_pool2d(functional.pad(x, (0, 1, 0, 1), value=float("-inf")), 2, stride=1)
        kernel = self.get_buffer("kernel").to(x.dtype)
        return functional.conv2d(x, kernel, stride=2, padding=1, groups=self.channels)


_HIDDEN = -30000.0  # Score of a point that does not exist.


@dataclass(frozen=True)
class PointNetWidths:
    """Feature width, number of layers and number of attention heads of a ``PointNet``."""

    width: int = 128
    layers: int = 4
    heads: int = 4

    def as_dict(self) -> dict[str, int]:
        """Return the sizes as a dict by name."""
        return asdict(self)


@dataclass(frozen=True)
class LabelReading:
    """Output of the network for B clouds of up to N points."""

    scores: torch.Tensor
    """(B, N, 54) score of each label, ghost last. A softmax over labels describes a point, over points a marker."""
    missing: torch.Tensor  # (53,) score for a marker that has no point.
    positions: torch.Tensor  # (B, 77, 3) metres.
    spread: torch.Tensor
    """(B, 77, 6): log diagonal and lower part of L, the Cholesky factor of the position's precision in 1/dm²."""


class PointNet(nn.Module):
    """Attention network that reads landmarks from points. Landmarks query the points, with biases by distance."""

    def __init__(self, widths: PointNetWidths = PointNetWidths()) -> None:
        super().__init__()
        self.widths = widths
        d, heads = widths.width, widths.heads
        self.embed = nn.Linear(3 + 6 * len(FREQUENCIES), d)
        self.by_distance = nn.Linear(len(NEARNESS), widths.layers * heads, bias=False)
        self.layers = nn.ModuleList(AttentionLayer(d, heads) for _ in range(widths.layers))
        self.norm = nn.LayerNorm(d)
        self.labels = nn.Linear(d, GHOST + 1)
        self.missing = nn.Parameter(torch.zeros(len(MARKERS)))
        self.queries = nn.Parameter(0.5 * torch.randn(len(LANDMARKS), d))
        self.asking = _Asking(d, heads)
        self.point_at = nn.Linear(d, d, bias=False)
        self.pointed = nn.Linear(d, d, bias=False)
        self.offset = nn.Linear(d, 3)
        self.spread = nn.Linear(d, 6)
        self.register_buffer("frequencies", torch.tensor(FREQUENCIES), persistent=False)
        self.register_buffer("nearness", torch.tensor(NEARNESS), persistent=False)

    def forward(self, points: torch.Tensor, seen: torch.Tensor, asked_of: int | None = None) -> LabelReading:
        """Read the points (B, N, 3) that ``seen`` (B, N) marks.

        Landmarks are computed only for the first ``asked_of`` clouds.
        """
        waves = (points[..., None] * self.get_buffer("frequencies")).flatten(-2)
        x = self.embed(torch.cat((points, waves.sin(), waves.cos()), -1))
        apart = (points[:, :, None] - points[:, None]).square().sum(-1).clamp(min=1e-8).pow(0.25)
        near = torch.exp(-((apart[..., None] - self.get_buffer("nearness")) / NEARNESS_WIDTH).square())
        gone = torch.where(seen, 0.0, _HIDDEN)
        bias = self.by_distance(near).permute(0, 3, 1, 2) + gone[:, None, None]
        for layer, part in zip(self.layers, bias.chunk(len(self.layers), dim=1), strict=True):
            x = layer(x, part)
        x = self.norm(x)
        scores = self.labels(x)
        x, gone, points = x[:asked_of], gone[:asked_of], points[:asked_of]
        asked = self.asking(self.queries.expand(len(x), -1, -1), x, gone[:, None, None])
        aim = self.point_at(asked) @ self.pointed(x).transpose(1, 2) * x.shape[-1] ** -0.5 + gone[:, None]
        positions = aim.softmax(-1) @ points + self.offset(asked)
        return LabelReading(scores, self.missing, positions, self.spread(asked))


class _Asking(nn.Module):
    """Attention of landmarks to points and then to each other, followed by two dense layers."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q, self.kv, self.out = nn.Linear(width, width), nn.Linear(width, 2 * width), nn.Linear(width, width)
        self.among = AttentionLayer(width, heads)

    def forward(self, asking: torch.Tensor, x: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        k, v = (split_heads(part, self.heads) for part in self.kv(x).chunk(2, -1))
        asking = asking + self.out(attention(split_heads(self.q(asking), self.heads), k, v, bias))
        return self.among(asking)


MARKER_SHARE, POSITION_SHARE, SPREAD_SHARE = 0.5, 4.0, 0.05
FREEDOM = 4.0
"""Degrees of freedom in Student's t. Chosen by hand."""
_SHARP_M = 0.01  # Distance in metres below which the loss is quadratic. Chosen by hand.


def point_loss(reading: LabelReading, clouds: Clouds) -> torch.Tensor:
    """Return the loss of a ``PointNet``: cross-entropy of the labels, plus distance and likelihood of the positions.

    For each point, a softmax over the markers and the ghost gives the label. For each marker, a softmax over the points
    and "missing" gives the point. Covariances do not affect positions during training, so that no landmark is neglected
    as uncertain.
    """
    weight = clouds.weight / clouds.weight.mean()
    seen = clouds.labels >= 0
    row = cross_entropy(reading.scores.transpose(1, 2), clouds.labels.clamp(min=0), reduction="none")
    row = (row * seen).sum(1) / seen.sum(1).clamp(min=1)
    by_marker = torch.where(seen[..., None], reading.scores[..., :GHOST], -30000.0)
    lacking = reading.missing.expand(len(by_marker), 1, -1)
    mine = clouds.labels[..., None] == torch.arange(GHOST, device=seen.device)
    which = torch.where(mine.any(1), mine.float().argmax(1), mine.shape[1])
    column = cross_entropy(torch.cat((by_marker, lacking), 1), which, reduction="none").mean(1)
    error = reading.positions - clouds.targets[: len(reading.positions)]
    distance = (error.square().sum(-1) + _SHARP_M**2).sqrt() - _SHARP_M
    likelihood = spread_loss(reading.spread, 10.0 * error.detach())
    positions = POSITION_SHARE * distance.mean(1) + SPREAD_SHARE * likelihood.mean(1)
    position_weight = weight[: len(positions)]
    return (weight * (row + MARKER_SHARE * column)).mean() + (position_weight * positions).mean()


def spread_loss(spread: torch.Tensor, error: torch.Tensor) -> torch.Tensor:
    """Return the negative log likelihood of errors e (..., 3) in dm under Student's t with ν = 4.

    ``(ν + 3)/2 log(1 + |Lᵀ e|²/ν) - log det L`` with the factors L in ``spread`` (..., 6). The tails are heavy, so that
    a single wrong landmark does not inflate all covariances.
    """
    log_diagonal, lower = spread[..., :3].clamp(-4.0, 5.0), spread[..., 3:]
    diagonal = log_diagonal.exp()
    x, y, z = error.unbind(-1)
    white = (
        (diagonal[..., 0] * x + lower[..., 0] * y + lower[..., 1] * z).square()
        + (diagonal[..., 1] * y + lower[..., 2] * z).square()
        + (diagonal[..., 2] * z).square()
    )
    return 0.5 * (FREEDOM + 3.0) * torch.log1p(white / FREEDOM) - log_diagonal.sum(-1)


Loss = Literal["welsch", "bmse"]
Divergence = Literal["kullback-leibler", "jensen-shannon"]
"""Losses for heatmaps. The paper uses Jensen-Shannon. Its gradient is zero for a map that is confidently wrong."""
ALL_LANDMARKS = tuple(range(len(MARKERS) + len(JOINTS)))
PUBLISHED_JOINTS: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_foot",
    "right_foot", "spine3", "neck", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist",
)  # fmt: skip
"""The 18 joints of the published network. They are chosen by hand, because the paper does not list them."""
PUBLISHED = (*range(len(MARKERS)), *(len(MARKERS) + JOINTS.index(name) for name in PUBLISHED_JOINTS))
"""Columns of the 53 markers and 18 joints in the 77 landmarks."""
BMSE_SIGMA = 0.02  # Noise in balanced MSE, in normalised units.


class LandmarkModel(nn.Module, ABC):
    """A network that estimates landmark positions from clouds."""

    columns: tuple[int, ...] = ALL_LANDMARKS  # Those of the 77 landmarks that it estimates.
    half_precision: bool = True
    """True if a GPU may round products to bfloat16 in training. For coordinates, this costs millimetres of accuracy."""

    @abstractmethod
    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Return the mean loss of the clouds, weighted by sample."""

    @abstractmethod
    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return positions (B, columns, 3) in metres, Z up, in the frame of the clouds."""


class Ours(LandmarkModel):
    """The product's own network, which uses attention over the points."""

    half_precision = False

    def __init__(self, widths: PointNetWidths = PointNetWidths(), asked_share: float = 1.0) -> None:
        super().__init__()
        self.net = PointNet(widths)
        self.asked_share = asked_share
        """Fraction of a batch that learns positions. They take a third of the time, and labels are harder to learn."""

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Return the sum of the losses for labels, positions and covariances."""
        share = None if self.asked_share == 1.0 else max(1, round(self.asked_share * len(clouds.points)))
        return point_loss(self.net(clouds.points, clouds.seen, share), clouds)

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return the landmark positions, computed by attention and offsets."""
        return self.net(clouds.points, clouds.seen).positions


class Published(LandmarkModel):
    """The published network: one UNet reads both views in turn, and the views' y is averaged (thesis 4.2.3)."""

    def __init__(
        self,
        width: int = 32,
        columns: tuple[int, ...] = PUBLISHED,
        loss: Loss = "welsch",
        size: int = SIZE,
        divergence: Divergence = "kullback-leibler",
    ) -> None:
        super().__init__()
        self.columns, self.kind, self.size, self.divergence = columns, loss, size, divergence
        self.unet = UNet(1, len(columns), width)
        self.register_buffer("which", torch.tensor(columns), persistent=False)

    def logits(self, maps: torch.Tensor, every: int = 1) -> torch.Tensor:
        """Return heatmap logits (B, 2, L, H, W) for views (B, 2, H, W), at every ``every``-th pixel."""
        return self.unet(maps.flatten(0, 1)[:, None], every).unflatten(0, (-1, 2))

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Return the divergence of the heatmaps plus Welsch's loss or balanced MSE of the positions (4.14, 4.15)."""
        points, seen, _, targets = drawn(clouds)
        truth = targets[:, self.get_buffer("which")]
        views = torch.stack((truth[..., 0], truth[..., 2]), 1), torch.stack((truth[..., 1],) * 2, 1)
        gaussians, pixels = gaussians_near(*views, self.size)
        reading = read_maps(self.logits(depth_maps(points, seen, self.size)), pixels)
        divergence = divergence_from_gaussians if self.divergence == "jensen-shannon" else relative_entropy
        apart, found = divergence(gaussians, reading.log_near).mean((1, 2)), fused(reading)
        weight = clouds.weight / clouds.weight.mean()
        if self.kind == "bmse":
            return HEAT_SHARE * apart.mean() + balanced_mse(found, truth, BMSE_SIGMA)
        return (weight * (HEAT_SHARE * apart + WELSCH_SHARE * welsch(truth, found).mean(1))).mean()

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return the heatmaps' centres of mass, fused from both views."""
        points, seen, frame, _ = drawn(clouds)
        logits = self.logits(depth_maps(points, seen, self.size), SKIPPED)
        line = torch.linspace(-1.0, 1.0, self.size, device=logits.device)[::SKIPPED]
        return _z_up(frame.metres(fused(read_maps(logits, line=line))))


class DemocapLike(LandmarkModel):
    """Network that reads front and back depth maps, with a heatmap and a depth map per landmark (Chatzitofis 2021)."""

    def __init__(
        self, width: int = 32, columns: tuple[int, ...] = PUBLISHED, loss: Loss = "welsch", size: int = SIZE
    ) -> None:
        super().__init__()
        self.columns, self.kind, self.size = columns, loss, size
        self.unet = UNet(2, 2 * len(columns), width)
        self.register_buffer("which", torch.tensor(columns), persistent=False)

    def _read(self, maps: torch.Tensor, pixels: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """Return logarithms (B, L, n) of heatmaps at pixels, and positions (B, L, 3)."""
        logits, depth = self.unet(maps).chunk(2, 1)
        reading = read_maps(logits, pixels)
        heat = (logits - reading.log_total[..., None, None]).exp()
        z = (heat * depth.tanh()).sum((-2, -1))
        return reading.log_near, torch.stack((reading.across, reading.down, 1.25 * z), -1)

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Return heatmap divergence plus Welsch's loss or balanced MSE of positions, and absolute depth errors."""
        points, seen, _, targets = drawn(clouds)
        truth = targets[:, self.get_buffer("which")]
        gaussians, pixels = gaussians_near(truth[..., 0], truth[..., 1], self.size)
        log_near, found = self._read(front_and_back(points, seen, self.size), pixels)
        apart = relative_entropy(gaussians, log_near).mean(1)
        # Far from the truth, Welsch's gradient vanishes and heatmaps have no depth, so the absolute distance is used.
        depth = (found[..., 2] - truth[..., 2]).abs().mean(1)
        if self.kind == "bmse":
            return (HEAT_SHARE * apart + depth).mean() + balanced_mse(found, truth, BMSE_SIGMA)
        weight = clouds.weight / clouds.weight.mean()
        return (weight * (HEAT_SHARE * apart + WELSCH_SHARE * welsch(truth, found).mean(1) + depth)).mean()

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return the heatmaps' centres of mass with the expected depth."""
        points, seen, frame, _ = drawn(clouds)
        return _z_up(frame.metres(self._read(front_and_back(points, seen, self.size))[1]))


class FromCoordinates(LandmarkModel):
    """Network of dense layers on each point's coordinates, then the maximum over points (Chen 2021, Qi 2017)."""

    half_precision = False

    def __init__(self, width: int = 256, columns: tuple[int, ...] = PUBLISHED) -> None:
        super().__init__()
        self.columns = columns
        self.each = nn.Sequential(
            nn.Linear(3, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 4 * width)
        )
        self.all = nn.Sequential(
            nn.Linear(4 * width, 2 * width),
            nn.ReLU(),
            nn.Linear(2 * width, 2 * width),
            nn.ReLU(),
            nn.Linear(2 * width, 3 * len(columns)),
        )
        self.register_buffer("which", torch.tensor(columns), persistent=False)

    def _found(self, points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        features = torch.where(seen[..., None], self.each(points).float(), -1e4).amax(1)
        return self.all(features).float().unflatten(-1, (-1, 3))

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Return the mean distance between normalised positions."""
        points, seen, _, targets = drawn(clouds)
        error = self._found(points, seen) - targets[:, self.get_buffer("which")]
        weight = clouds.weight / clouds.weight.mean()
        return (weight * (error.square().sum(-1) + 1e-4).sqrt().mean(1)).mean()

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return the positions that the network regresses."""
        points, seen, frame, _ = drawn(clouds)
        return _z_up(frame.metres(self._found(points, seen)))


def balanced_mse(found: torch.Tensor, truth: torch.Tensor, sigma: float) -> torch.Tensor:
    """Return the batch-based balanced MSE of positions (B, L, 3) as a cross-entropy (Ren et al. 2022, eq. 3.9).

    In each sample, a landmark should be nearer to its own truth than to the truths of the other samples in the batch.
    """
    a, b = found.transpose(0, 1), truth.transpose(0, 1)
    logits = -torch.cdist(a, b).square() / (2.0 * sigma**2)
    own = torch.arange(len(found), device=found.device).expand(len(a), -1)
    return nn.functional.cross_entropy(logits.flatten(0, 1), own.flatten()) * 2.0 * sigma**2 * 100.0


def _z_up(points: torch.Tensor) -> torch.Tensor:
    return torch.stack((points[..., 0], -points[..., 2], points[..., 1]), -1)
