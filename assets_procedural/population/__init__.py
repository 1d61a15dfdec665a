"""Compute shape components from population statistics."""
