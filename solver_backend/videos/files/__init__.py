"""Videos as pictures with their true times, as sound, and as previews."""
