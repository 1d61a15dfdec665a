"""The motion carried over, in NumPy alone."""
