"""Colour images of the studio: shots set up by the solver, lit and rendered by Blender's engines."""
