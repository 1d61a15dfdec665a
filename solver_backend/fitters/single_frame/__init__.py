"""Every frame on its own: where a fit starts, and the fit (thesis eq. 6.5)."""
