"""The Python in which people are found in videos: which there is, what it has, and how one is made."""
