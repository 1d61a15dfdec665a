"""Shape components from population statistics."""
