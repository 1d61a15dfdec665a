"""Numbers as the three kinds of processor write them into C3D files.

The fourth byte of the parameter section names the processor (C3D file format user guide, Motion Lab Systems, "The
parameter header"): 84 Intel, little-endian IEEE; 85 DEC, little-endian integers and VAX F floats; 86 MIPS (SGI),
big-endian IEEE. Nothing in the header states it, which is why the parameter section is looked up first.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Processor(IntEnum):
    """What wrote the numbers; the value is the byte in the file."""

    INTEL = 84
    DEC = 85
    MIPS = 86


def integers(raw: np.ndarray, processor: Processor) -> np.ndarray:
    """Return signed 16-bit integers.

    Args:
        raw: (..., 2 n) bytes as uint8, contiguous along the last axis.
        processor: what wrote them.

    Returns:
        (..., n) int16.
    """
    return raw.view(">i2" if processor is Processor.MIPS else "<i2")


def floats(raw: np.ndarray, processor: Processor) -> np.ndarray:
    """Return 32-bit floats as float64.

    A VAX F float is two little-endian 16-bit words, the high one first, with an exponent that is 2 larger than that of
    the IEEE float with the same bits: ``value = ieee(high << 16 | low) / 4`` (VAX Architecture Reference Manual).
    Its 2^126 and above, which IEEE keeps for infinity and NaN, come out as those.

    Args:
        raw: (..., 4 n) bytes as uint8, contiguous along the last axis.
        processor: what wrote them.

    Returns:
        (..., n) float64.
    """
    with np.errstate(invalid="ignore"):
        if processor is not Processor.DEC:
            return raw.view(">f4" if processor is Processor.MIPS else "<f4").astype(np.float64)
        words = raw.view("<u2").astype(np.uint32)
        ieee = (words[..., 0::2] << 16) | words[..., 1::2]
        return ieee.view(np.float32).astype(np.float64) / 4.0


def unsigned(raw: np.ndarray, processor: Processor) -> np.ndarray:
    """Return (..., n) unsigned 16-bit integers of (..., 2 n) bytes."""
    return integers(raw, processor).view(">u2" if processor is Processor.MIPS else "<u2")
