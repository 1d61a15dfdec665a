"""Lights of colour pictures by the studio's names, alike in every engine: exposure, tint, shadows, noise of gain."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np


@dataclass(frozen=True)
class Light:
    """How a room is lit."""

    stops: float
    """Brighter or darker than by day; a camera's own exposure makes up for nothing."""
    tint: tuple[float, float, float]
    """Linear colour of the light."""
    shadow: float
    """How dark Workbench's shadows are, 0..1."""
    gain: float
    """Times the sensor's noise by day."""

    def set_up(self, scene: bpy.types.Scene) -> None:
        """Darken a scene that is rendered."""
        scene.view_settings.exposure += self.stops
        scene.display.shading.shadow_intensity = self.shadow

    def tinted(self, picture: np.ndarray) -> np.ndarray:
        """Return (h, w, 3) values of 0 to 255 in the light's colour: pictures are linear light to the power 1 / 2.2."""
        return picture * np.array(self.tint, np.float32) ** np.float32(1 / 2.2)


LIGHTS = {
    "day": Light(0.0, (1.0, 1.0, 1.0), 0.4, 1.0),
    "dim": Light(-1.2, (1.0, 0.8, 0.55), 0.6, 2.0),
    "night": Light(-2.4, (0.7, 0.85, 1.0), 0.8, 4.0),
}
"""Each light by its name; chosen by hand, see ``Light`` for units."""
