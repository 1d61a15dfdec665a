"""Read the images, times and sound of videos, and write previews."""
