"""Descent on manifolds (thesis 6.2.4), by which published methods minimise whole windows."""
