"""From points to poses while they come: network, tracks and a fit that starts from the frame before."""
