"""Train the lifter."""
