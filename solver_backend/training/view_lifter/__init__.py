"""Training the view lifter."""
