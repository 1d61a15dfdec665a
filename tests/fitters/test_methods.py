"""The table of methods: every name that settings allow has a row, and each row what the pipeline asks of it."""

from solver_backend.exchange.solve_settings import METHOD_NAMES
from solver_backend.fitters import pipeline


def test_settings_allow_the_methods_of_the_table_in_its_order() -> None:
    assert tuple(pipeline.METHODS) == METHOD_NAMES
    assert all(method.name == name for name, method in pipeline.METHODS.items())


def test_a_single_image_is_solved_by_the_methods_that_need_no_neighbours() -> None:
    assert [name for name, method in pipeline.METHODS.items() if method.per_frame] == ["frame", "noise-aware"]
    assert pipeline.METHODS["noise-aware"].finds_shape and pipeline.METHODS["noise-aware"].has_gaussian_codes
