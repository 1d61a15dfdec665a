"""Descent on manifolds (thesis 6.2.4), which published methods of whole windows minimise with."""
