"""Manifold MoCap for Blender: bakes solved motions into an animated, skinned body.

Importing the package does no work. Blender calls ``register`` and ``unregister``.
"""


def register() -> None:
    """Register everything of the table in ``registration.py``."""
    import gc

    # A hundred classes and modules make the collector walk through all of Blender's Python several times.
    collects = gc.isenabled()
    gc.disable()
    try:
        from .ui import registration

        registration.register()
    finally:
        if collects:
            gc.enable()


def unregister() -> None:
    """Unregister everything of the table, backwards."""
    from .ui import registration

    registration.unregister()
