"""Where the cameras stand, by one bundle adjustment."""
