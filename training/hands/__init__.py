"""Train the hand prior from recordings and poses whose licences are free."""
