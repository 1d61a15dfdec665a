"""Convert the implicit surface to a mesh with materials and texture charts."""
