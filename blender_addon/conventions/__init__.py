"""Conventions that hold in the whole add-on: coordinate frames, time, names and colours."""
