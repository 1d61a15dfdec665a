"""Minimise on manifolds, as published methods do for whole windows (thesis 6.2.4)."""
