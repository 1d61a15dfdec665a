"""Keys whose codes stay: the same equations without the columns of codes, and a decoder that is asked once."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend import __version__
from solver_backend.cli import spread
from solver_backend.fitters.keyframes.normal_equations import BundleModel, BundleObjective, MotionPrior, data_equations
from solver_backend.fitters.keyframes.optimise import Schedule, Stretch, solve_keys
from solver_backend.fitters.model.subject import Keyframes
from solver_backend.fitters.recipes.bundle import FIXED_CODES
from tests.support.layouts import WHOLE
from tests.support.stick_scene import ROTATIONS, StickScene
from tests.support.toy_prior import ToyPrior

TURNED = WHOLE.only(FIXED_CODES)
SCHEDULE = Schedule((12.0, 3.0), 6)


@pytest.fixture(scope="module")
def scene() -> StickScene:
    return StickScene()


@pytest.fixture(scope="module")
def keys(scene: StickScene) -> Keyframes:
    return replace(scene.start, residual=0.1 * np.random.default_rng(5).normal(size=(7, 21, 3)))


def data(scene: StickScene, layout) -> BundleModel:
    return BundleModel(scene.subject, scene.prior, BundleObjective(scene.objective), layout)


def model(scene: StickScene) -> BundleModel:
    smooth = MotionPrior(10 / 60, accel_sigma=20.0, angular_sigma=90.0, latent_sigma=60.0)
    return replace(scene.model(smooth, ROTATIONS), free=TURNED)


def test_gradient_equals_central_differences(scene, keys) -> None:
    rows, step, rng = scene.layout.rows(), 1e-6, np.random.default_rng(6)
    gradient = data_equations(data(scene, TURNED), keys, rows, 3.0).gradient
    assert gradient.shape == (7, TURNED.dof)
    for _ in range(4):
        direction = rng.normal(size=gradient.shape)
        moved = [keys.retract(s * step * direction, TURNED) for s in (1, -1)]
        ahead, behind = (data_equations(data(scene, TURNED), some, rows, 3.0).cost.sum() for some in moved)
        np.testing.assert_allclose((gradient * direction).sum(), (ahead - behind) / (2 * step), rtol=1e-5)


def test_equations_are_those_of_free_codes_without_their_columns(scene, keys) -> None:
    rows, columns = scene.layout.rows(), WHOLE.columns(FIXED_CODES)
    whole, fixed = (data_equations(data(scene, layout), keys, rows, 3.0) for layout in (WHOLE, TURNED))
    np.testing.assert_allclose(fixed.cost, whole.cost, rtol=1e-12)
    np.testing.assert_allclose(fixed.gradient, whole.gradient[:, columns], rtol=1e-9, atol=1e-6)
    both = np.concatenate([columns, WHOLE.dof + columns])
    expected = whole.normal_equations().diagonal[:, both][:, :, both]
    found = fixed.normal_equations().diagonal
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_codes_stay_and_the_decoder_is_asked_for_no_derivative(scene, keys, monkeypatch) -> None:
    decoded: list[int] = []

    def once(self: ToyPrior, z: np.ndarray) -> np.ndarray:
        decoded.append(len(z))
        return decode(self, z)

    def never(*_: object) -> None:
        raise AssertionError("a derivative of the decoder was formed")

    decode = ToyPrior.decode
    monkeypatch.setattr(ToyPrior, "decode_with_vjp", never)
    monkeypatch.setattr(ToyPrior, "decode_with_jacobian", never)
    monkeypatch.setattr(ToyPrior, "decode", once)
    found = solve_keys(model(scene), scene.layout, keys, SCHEDULE)
    assert sum(decoded) == scene.layout.rows().frames.size
    np.testing.assert_array_equal(found.keys.z, keys.z)
    assert scene.error_mm(found.keys) < 0.7 * scene.error_mm(keys)


def test_a_worker_frees_what_the_take_frees(scene, keys) -> None:
    stretch = Stretch(model(scene), scene.layout, keys, SCHEDULE, np.zeros(7, dtype=bool))
    rest = stretch.model.objective, stretch.model.free, stretch.layout, stretch.keys, stretch.schedule, stretch.fixed
    there = spread._solve((stretch.model.subject, stretch.model.prior), rest, __version__)
    np.testing.assert_array_equal(there.keys.residual, stretch.solve().keys.residual)
