"""Write a self-contained page about a solve: its quality, frames to check, and settings."""
