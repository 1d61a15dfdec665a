"""What is seen close up, laid over the fitted mesh: fingers at rest, wrist, toes, eyes and lips."""
