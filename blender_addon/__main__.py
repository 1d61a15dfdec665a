"""``python -m blender_addon``: the add-on's work without Blender's window."""

from .headless.leave import leave
from .headless.main import main

if __name__ == "__main__":
    leave(main())
