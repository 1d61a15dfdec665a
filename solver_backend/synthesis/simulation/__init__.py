"""What a camera sees of a moving body: who is hidden where, and what detectors make of it."""
