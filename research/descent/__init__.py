"""Descent on manifolds (thesis 6.2.4), the minimiser of published methods for whole windows."""
