"""One clock for cameras that were started by hand and run at slightly other rates."""
