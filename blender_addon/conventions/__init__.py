"""Conventions of the whole add-on: frames, time, names and colours."""
