"""Read images, times and sound from videos, and write previews."""
