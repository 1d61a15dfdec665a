"""From the surface to a mesh with materials and texture charts."""
