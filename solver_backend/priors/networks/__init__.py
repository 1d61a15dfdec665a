"""Dense networks in NumPy or torch arrays, forward and with derivatives."""
