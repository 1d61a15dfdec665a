"""Train the view lifter."""
