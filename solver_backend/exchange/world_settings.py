"""How the world of a calibration is scaled and levelled, declared once for the command line, jobs and panels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .setting import Choice, check_settings, defaults_of_class, setting

WORLD = "World"
"""The group."""
AUTO, ON, OFF = "auto", "on", "off"
LEVELS = (
    Choice(AUTO, "Where Sure", "Level the world where balance, floor and cameras show that it is tilted"),
    Choice(ON, "By the Person", "Level the world by the person who stands and walks in it"),
    Choice(OFF, "As Calibrated", "Keep up and floor of the calibration"),
)


@dataclass(frozen=True, kw_only=True)
class WorldSettings:
    """What is done to the calibration's world before anything is solved.

    Raises:
        JobInvalid: a value is of another type or out of range.
    """

    stature: float = setting(
        "number", 0.0, "Stature", "Height of the person, to which the world is scaled; 0 keeps the calibration's scale",
        group=WORLD, low=0, high=2.6, unit="m",
    )  # fmt: skip
    """The person is whoever is solved; in metres, barefoot."""
    scale: float = setting(
        "number", 1.0, "Scale", "Factor on the lengths of the calibration, if its unit is not a known one",
        group=WORLD, low=1e-6, high=1e6, soft_high=10,
    )  # fmt: skip
    """Such as the size of a board's square in metres, where the board was calibrated in squares."""
    level: str = setting(
        "choice", AUTO, "Level", "Whether the world is levelled: Z up, the floor at z = 0",
        group=WORLD, choices=LEVELS, metavar="NAME",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def changes_world(self) -> bool:
        """Whether the world is to be changed whatever is found."""
        return bool(self.stature) or self.scale != 1.0 or self.level == ON


def world_values(values: Any) -> dict[str, Any]:
    """Return the settings of the world that an object has and that are not at their defaults, by name."""
    defaults = defaults_of_class(WorldSettings)
    return {name: getattr(values, name) for name in defaults if getattr(values, name) != defaults[name]}
