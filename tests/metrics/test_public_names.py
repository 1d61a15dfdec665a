"""What the package promises is there."""

from solver_backend import metrics


def test_every_public_name_exists_once_in_order():
    assert list(metrics.__all__) == sorted(set(metrics.__all__))
    assert all(callable(getattr(metrics, name)) for name in metrics.__all__)
