"""Colours of confidence."""

from __future__ import annotations

import numpy as np

from blender_addon.review.ranges import colours


def test_colours_go_from_red_over_amber_to_green():
    red, amber, green = colours(np.array([0.0, 0.6, 1.0]))
    assert red[0] > 3 * red[1] and green[1] > 2 * green[0] and min(amber[0], amber[1]) > 0.7
    shades = colours(np.linspace(0, 1, 101))
    assert shades.min() >= 0 and shades.max() <= 1 and np.abs(np.diff(shades, axis=0)).max() < 0.05
