"""Solve, bake, export and render without Blender's window, for one capture or a folder of captures."""
