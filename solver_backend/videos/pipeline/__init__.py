"""Take a folder of videos to solved motions, and keep what was made before."""
