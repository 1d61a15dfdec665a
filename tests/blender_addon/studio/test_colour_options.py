"""Options of colour do what they are called: light, exposure, noise, an open shutter and one that rolls."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon.studio.colour_film import film_in_colour
from solver_backend.io.png import read_png
from tests.support.studio_shots import QUIET, colour_shot

ARRAY = {"layout": "ring", "count": 1, "size": [192, 144], "radius_m": 2.6, "turn_deg": 60}


def picture(
    folder: Path, light: str = "day", people: dict[str, Any] | None = None, frame: int = 0, **rgb: float
) -> np.ndarray:
    """Return a picture of somebody who moves, (h, w, 3) floats."""
    look = {"clothes": "tee_shorts", "hair": "short", "light": light}
    shot = colour_shot(
        folder, camera_arrays=[ARRAY], frames=frame + 1, fps=2, seed=3, looks=[look], people=people or {},
        rgb={**QUIET, **rgb},
    )  # fmt: skip
    film_in_colour(shot)
    return read_png(shot / "rgb" / "cam01" / f"{frame:06d}.png").astype(float)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    return picture(tmp_path_factory.mktemp("plain"))


@pytest.mark.slow
def test_night_is_darker_than_dim_and_bluer(plain: np.ndarray, tmp_path: Path) -> None:
    dim, night = picture(tmp_path / "dim", "dim"), picture(tmp_path / "night", "night")
    assert plain.mean() > 1.2 * dim.mean() > 1.2 * night.mean() > 10
    for shown, warmer in ((dim, True), (night, False)):
        ratio = (shown[..., 0].sum() / shown[..., 2].sum()) / (plain[..., 0].sum() / plain[..., 2].sum())
        assert ratio > 1.1 if warmer else ratio < 0.95


@pytest.mark.slow
def test_night_is_louder(tmp_path: Path) -> None:
    night = picture(tmp_path / "night", "night")
    loud = picture(tmp_path / "loud", "night", noise=0.01)
    assert np.std(loud - night) == pytest.approx(4 * 2.55, rel=0.25)


def test_a_stop_is_twice_the_light(plain: np.ndarray, tmp_path: Path) -> None:
    less = picture(tmp_path, exposure=-1.0)
    kept = (plain > 60) & (plain < 200)
    assert np.median((plain[kept] / less[kept]) ** 2.2) == pytest.approx(2.0, rel=0.15)


def test_noise_has_its_size(plain: np.ndarray, tmp_path: Path) -> None:
    off = picture(tmp_path, noise=0.03) - plain
    kept = (plain > 40) & (plain < 215)
    assert np.std(off[kept]) == pytest.approx(0.03 * 255, rel=0.05) and abs(np.mean(off[kept])) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("option", [{"blur": 0.8}, {"rolling_s": 0.4}])
def test_shutters_change_what_moves_and_nothing_else(tmp_path: Path, option: dict[str, float]) -> None:
    plain = picture(tmp_path / "plain", frame=1)
    off = np.abs(picture(tmp_path, frame=1, **option) - plain).max(axis=2)
    moved = off > 12
    assert 0.003 < moved.mean() < 0.25
    assert np.median(off) <= 1.0, "the room stands still"
    if "blur" in option:
        shown = picture(tmp_path / "again", frame=1, **option)
        assert np.array_equal(np.abs(shown - plain).max(axis=2), off), "the same again"


@pytest.mark.slow
def test_a_strange_body_is_another_one(plain: np.ndarray, tmp_path: Path) -> None:
    shown = picture(tmp_path, people={"strange": True})
    assert (np.abs(shown - plain).max(axis=2) > 12).mean() > 0.01
