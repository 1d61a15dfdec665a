"""How an OAK is set: what must stay the same while a take is recorded, and how several of them keep in step."""

from __future__ import annotations

from dataclasses import dataclass

from solver_backend.exchange.errors import CommandLineInvalid

SYNCS = ("none", "master", "slave", "ptp")
"""By no wire; giving and taking the wire's pulse (M8 or FSIN); by the network's clock (OAK-4 over Ethernet)."""
SIZES = ((640, 400), (1280, 800))
"""Pictures of the mono cameras."""


@dataclass(frozen=True)
class OakSettings:
    """Constants of one OAK with two mono cameras and an infrared flood."""

    fps: float = 60.0
    """Frames a second; 60 is what 640 x 400 with depth gives, 1280 x 800 about 30."""
    size: tuple[int, int] = (640, 400)
    """Width and height of infrared and depth, px."""
    exposure_us: int = 800
    """Fixed: a hand at 5 m/s moves 4 mm meanwhile."""
    iso: int = 200
    """Fixed; low, so that all but what reflects stays dark."""
    flood: float = 1.0
    """Infrared flood light, 0 to 1; retro-reflective markers need it."""
    sync: str = "none"
    """One of ``SYNCS``."""
    silent_s: float = 5.0
    """Seconds without a frame after which the device counts as gone."""
    queue: int = 4
    """Frames that wait for the host; older ones are dropped, so that what comes is new."""

    def __post_init__(self) -> None:
        if self.sync not in SYNCS:
            raise CommandLineInvalid(
                f"'{self.sync}' is not a way to synchronise OAKs.", hint=f"One of {', '.join(SYNCS)}."
            )
        if tuple(self.size) not in SIZES:
            message = ", ".join(f"{w} x {h}" for w, h in SIZES)
            raise CommandLineInvalid(
                f"Pictures of {self.size} are not possible with an OAK's mono cameras.", hint=f"One of {message}."
            )
        if not (0 < self.fps <= 120 and 0.0 <= self.flood <= 1.0 and 100 <= self.iso <= 1600):
            raise CommandLineInvalid(
                f"{self.fps} frames a second, flood {self.flood} and ISO {self.iso} cannot be set.",
                hint="Up to 120 frames a second, 0 to 1, 100 to 1600.",
            )
        if not 20 <= self.exposure_us <= 0.9e6 / self.fps:
            raise CommandLineInvalid(
                f"An exposure of {self.exposure_us} microseconds does not fit into {self.fps:g} frames a second.",
                hint="500 to 1500 keep a moving marker sharp.",
            )
