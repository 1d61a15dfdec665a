"""A limb whose labels name no side is that of the side of the trunk it is on; what is not clear stays unknown."""

import numpy as np
import pytest

from solver_backend.body.marker_names import places_by_side
from solver_backend.types import MarkerCloud

TRUNK = {"ASISl": (0.12, 1.0), "ASISr": (-0.12, 1.0), "XIPH": (0.0, 1.3), "T10": (0.0, 1.3)}
ARM = {"ACRO_tip": ("SHO", 0.18), "EPICl": ("ELB", 0.35), "EPICm": ("ELM", 0.30), "STYLr": ("WRA", 0.30),
       "STYLu": ("WRB", 0.33), "WRIST": ("WRI", 0.32)}  # fmt: skip


def cloud(arm=1.0, **places):
    points = TRUNK | {label: (arm * x, 1.2) for label, (_, x) in ARM.items()} | places
    turn = np.linspace(0.0, 3.0, 20)[:, None]
    x, z = (np.array([point[axis] for point in points.values()])[None] for axis in (0, 1))
    return MarkerCloud(np.stack([x * np.cos(turn), x * np.sin(turn), z + 0 * turn], axis=-1), 50.0, tuple(points))


@pytest.mark.parametrize(("arm", "side"), [(1.0, "L"), (-1.0, "R")])
def test_an_arm_is_on_its_side(arm, side):
    assert places_by_side(cloud(arm), {}) == {label: side + part for label, (part, _) in ARM.items()}


def test_what_is_not_clear_stays_unknown():
    assert not places_by_side(cloud(WRIST=(-0.3, 1.2)), {})
    assert not places_by_side(cloud(RSHO=(-0.2, 1.4)), {"RELB": "RELB"} | dict.fromkeys(TRUNK, ""))
    assert not places_by_side(cloud(LELB=(0.3, 1.2)), {})
    unseen = cloud()
    unseen.positions[:, 0] = np.nan
    assert not places_by_side(unseen, {})
    assert "WRIST" not in places_by_side(cloud(), {"WRIST": "LWRA"})
