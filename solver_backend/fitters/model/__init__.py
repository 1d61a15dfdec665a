"""What is solved for: poses, codes and the curves that keyframes span."""
