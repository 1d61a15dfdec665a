"""Add the close-up detail to the fitted mesh: fingers at rest, wrist, toes, eyes and lips."""
