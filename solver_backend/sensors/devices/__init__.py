"""Read all sensors through one interface: recordings, studio renderings, and connected devices."""
