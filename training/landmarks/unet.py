"""The published network's UNet (paper's supplement B): five blocks, anti-aliased pooling, bilinear upsampling."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

BLOCKS = 5
"""Resolutions of the network, each half the one before; chosen by hand."""


class UNet(nn.Module):
    """Maps to maps of the same size.

    Blocks of ``width * (1, 2, 4, 8, 16)`` features, two 3 x 3 convolutions each, ReLU, then batch normalisation, as the
    paper orders them; 32 is the paper's width.
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
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def forward(self, maps: torch.Tensor, every: int = 1) -> torch.Tensor:
        """Return (B, outputs, H, W) of (B, inputs, H, W), H and W divisible by 16; of every so many pixels."""
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
        """Return the prediction layer's maps, each contiguous: as a product, for they are read one by one."""
        weight, bias = self.predict.weight.flatten(1), self.predict.bias
        assert bias is not None
        maps = torch.baddbmm(bias[None, :, None], weight.expand(x.shape[0], -1, -1), x.flatten(2))
        return maps.unflatten(2, x.shape[2:])


class _ConvolutionBlock(nn.Sequential):
    def __init__(self, inputs: int, outputs: int, convolutions: int = 2) -> None:
        layers: list[nn.Module] = []
        for number in range(convolutions):
            layers += [
                nn.Conv2d(outputs if number else inputs, outputs, 3, padding=1), nn.ReLU(), nn.BatchNorm2d(outputs),
            ]  # fmt: skip
        super().__init__(*layers)


class _SmoothPool(nn.Module):
    """Largest of 2 x 2 at every pixel, then every second one of what a binomial filter left (Zhang 2019)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        row = torch.tensor([1.0, 2.0, 1.0]) / 4.0
        self.channels = channels
        self.register_buffer("kernel", (row[:, None] * row).expand(channels, 1, 3, 3).clone(), persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = functional.max_pool2d(functional.pad(x, (0, 1, 0, 1), value=float("-inf")), 2, stride=1)
        kernel = self.get_buffer("kernel").to(x.dtype)
        return functional.conv2d(x, kernel, stride=2, padding=1, groups=self.channels)
