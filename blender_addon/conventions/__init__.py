"""Conventions of the whole add-on: coordinate frames, time, names and colours."""
