"""Define the unknowns of a solve: poses, codes and the curves through keyframes."""
