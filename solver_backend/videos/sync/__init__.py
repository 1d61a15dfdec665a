"""Synchronise cameras that were started by hand and run at slightly different rates."""
