"""Code shared by the solver and the add-on. It depends only on NumPy."""
