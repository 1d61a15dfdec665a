"""Train the networks that read marker clouds (thesis chapter 4)."""
