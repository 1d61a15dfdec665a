"""Rigs and skeletons of any program: roles of their bones on a person, recognised from names and structure."""
