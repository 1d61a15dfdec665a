"""Train SPoser (thesis 6.1-6.4)."""
