"""Bake solved motions as an animated, skinned body in Blender.

Importing the package does nothing else. Blender calls ``register`` and ``unregister``.
"""


def register() -> None:
    """Register all classes and handlers listed in ``registration.py``."""
    import gc

    # Registering many classes would trigger Python's garbage collector several times.
    collects = gc.isenabled()
    gc.disable()
    try:
        from .ui import registration

        registration.register()
    finally:
        if collects:
            gc.enable()


def unregister() -> None:
    """Unregister all classes and handlers in reverse order."""
    from .ui import registration

    registration.unregister()
