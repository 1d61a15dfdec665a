"""``python -m blender_addon``: the add-on's work without Blender's window."""

from ._exchange.early_signals import end_by_signals

if __name__ == "__main__":
    end_by_signals()

from .headless.main import main
from .headless.process import leave

if __name__ == "__main__":
    leave(main())
