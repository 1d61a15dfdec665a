"""Write one page about a solve: its quality, the frames to check, and its settings. The page needs no network."""
