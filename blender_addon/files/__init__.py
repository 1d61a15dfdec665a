"""Readers of the files the solver writes: motions, captures and bodies; NumPy alone, no Blender, no pickle."""
