"""Manifold MoCap for Blender: bakes solved motions into an animated, skinned body.

Importing the package does no work; Blender calls ``register`` and ``unregister``.
"""


def register() -> None:
    """Register everything of the table in ``registration.py``."""
    from .ui import registration

    registration.register()


def unregister() -> None:
    """Unregister everything of the table, backwards."""
    from .ui import registration

    registration.unregister()
