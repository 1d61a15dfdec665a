"""One road from a folder of videos to a solved motion: what is there, what is missing, and what is done about it."""
