"""``python -m blender_addon``: the add-on's work without Blender's window."""

import sys

from .headless.main import main

if __name__ == "__main__":
    sys.exit(main())
