"""Unknowns of a solve: poses, codes and the curves that keyframes span."""
