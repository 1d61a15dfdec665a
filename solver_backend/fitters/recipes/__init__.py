"""Solve the poses in a take, with one file per method. ``fitters/pipeline.py`` lists the methods."""
