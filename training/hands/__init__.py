"""Train the hand prior from recordings and poses with free licences."""
