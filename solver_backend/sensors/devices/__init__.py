"""Read recordings, studio renderings and connected depth sensors through one interface."""
