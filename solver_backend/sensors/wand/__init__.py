"""Where sensors stand, from a wand that is waved before them: a marker on a stick, or a bar with three lights."""
