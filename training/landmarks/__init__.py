"""Train the networks that read clouds of markers (thesis chapter 4)."""
