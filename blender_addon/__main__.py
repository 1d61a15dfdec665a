"""The add-on's command line, which runs without Blender's window: ``python -m blender_addon``."""

from ._exchange.early_signals import end_by_signals

if __name__ == "__main__":
    end_by_signals()

from .headless.main import main
from .headless.process import leave

if __name__ == "__main__":
    leave(main())
