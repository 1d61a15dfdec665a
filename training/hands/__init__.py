"""Train the hand prior from recordings and poses under free licences."""
