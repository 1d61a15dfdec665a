"""When sensors expose: by a trigger, or by how the wand moves."""
