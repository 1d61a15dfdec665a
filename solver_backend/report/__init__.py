"""Write one self-contained page about a solve: quality, frames to check, settings."""
