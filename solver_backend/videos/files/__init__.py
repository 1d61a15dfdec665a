"""Read the pictures, times and sound of videos, and write previews."""
