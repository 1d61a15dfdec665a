"""Tools around the product: its components, generated pages, checks and tests."""
