"""Takes out of Blender: one file a format, and the table that lists them."""
