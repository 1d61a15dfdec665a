"""Convert the implicit surface to a mesh that has materials and texture charts."""
