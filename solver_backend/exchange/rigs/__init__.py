"""Rigs and skeletons of any program: roles of their bones on a person, told from names and structure."""
