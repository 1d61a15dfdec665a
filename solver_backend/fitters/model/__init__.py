"""Unknowns of a solve: poses, codes and the curves through keyframes."""
