"""Read sensors through one interface: recordings, renderings of the studio, and connected devices."""
