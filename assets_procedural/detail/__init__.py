"""Add close-up detail to the fitted mesh: fingers at rest, wrists, toes, eyes and lips."""
