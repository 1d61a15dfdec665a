"""Add close-up detail to the fitted mesh: resting fingers, wrists, toes, eyes and lips."""
