"""Colour images for the studio. The solver sets up the shots, and Blender's engines light and render them."""
