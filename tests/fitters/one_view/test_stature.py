"""The size of a person whom one camera sees: given, by the floor, or the average's with its spread."""

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.fitters.one_view.measure import (
    AT_ODDS_SIGMAS,
    PEOPLE_SIGMA,
    SHAPE_SIGMA,
    betas_of_size,
    measured_size,
    size_by_floor,
    size_of,
)
from solver_backend.types import Capture

NAMES = ("left_heel", "right_heel", "nose")
SEEN = np.ones((10, 3), dtype=bool)
SOLE = 0.02
SIGMA = np.full((10, 3), 0.05)


def standing(size: float, camera: float = 1.6) -> np.ndarray:
    """Return where an average person would stand who looks like one ``size`` times as large on the floor."""
    points = np.zeros((10, 3, 3))
    points[:, :2, 2] = SOLE + camera - camera / size
    points[:, 2, 2] = 1.6
    return points


@pytest.mark.parametrize("size", [0.93, 1.0, 1.08])
def test_feet_on_the_floor_say_the_size(size: float) -> None:
    found = size_by_floor(measured_size(standing(size), NAMES, SEEN, 1.6, SIGMA))
    assert found.source == "feet on the floor" and found.has_floor and found.sigma < PEOPLE_SIGMA
    assert abs(found.factor - 1.0) <= abs(size - 1.0) + 1e-9
    assert (found.factor - 1.0) * (size - 1.0) >= 0 and abs(found.factor - size) < 0.05


def test_frames_whose_feet_are_unsure_do_not_say_the_size() -> None:
    points, sigma = standing(1.0), SIGMA.copy()
    points[:6, :2, 2] -= 0.12  # lifted too low while the person squats
    assert measured_size(points, NAMES, SEEN, 1.6, sigma)[0] < 0.95  # type: ignore[index]
    sigma[:6] *= 1.5
    assert measured_size(points, NAMES, SEEN, 1.6, sigma)[0] == pytest.approx(1.0)  # type: ignore[index]


def test_a_floor_that_nobody_could_stand_on_is_none() -> None:
    for size in (0.5, 2.0):
        found = size_by_floor(measured_size(standing(size), NAMES, SEEN, 1.6, SIGMA))
        assert (found.factor, found.sigma, found.has_floor) == (1.0, PEOPLE_SIGMA, False)
    assert AT_ODDS_SIGMAS * PEOPLE_SIGMA < 0.5
    assert not size_by_floor(measured_size(standing(1.0), NAMES, SEEN, 0.0, SIGMA)).has_floor
    assert not size_by_floor(measured_size(standing(1.0)[:, 2:], ("nose",), SEEN[:, 2:], 1.6, SIGMA[:, 2:])).has_floor


def test_what_is_given_binds_and_a_floor_from_the_person_says_nothing() -> None:
    body = load_body()

    def size(betas=None, **known):
        return size_of(Capture("one", **known), body, betas, standing(1.05), NAMES, SEEN, 1.6, SIGMA)

    assert size().source == "feet on the floor"
    assert size((0.0,) * 10).sigma == SHAPE_SIGMA and size((0.0,) * 10).factor == 1.0
    shape = tuple(betas_of_size(body, 1.1))
    assert size(shape).factor == pytest.approx(1.1, abs=5e-3) and size(shape).at_odds == (0.0, 0.0)
    far = size(tuple(betas_of_size(body, 1.6)))
    assert far.at_odds[0] == pytest.approx(1.05, abs=1e-6) and not far.has_floor
    tall = size(stature_m=1.05 * body.stature_m)
    assert tall.factor == pytest.approx(1.05) and tall.sigma == SHAPE_SIGMA
    assert size(floor_from_person=True).sigma == PEOPLE_SIGMA


def test_a_shape_of_a_size_is_that_much_taller() -> None:
    body = load_body()
    names = body.layout.joints
    for factor in (0.92, 1.0, 1.1):
        rest, average = body.rest_joints(betas_of_size(body, factor)), body.joints_template
        tall = [joints[names.index("head"), 1] - joints[names.index("left_ankle"), 1] for joints in (rest, average)]
        assert tall[0] / tall[1] == pytest.approx(factor, abs=5e-3)
