"""``batch``: every capture of a folder solved and, if wanted, baked, rendered and exported."""
