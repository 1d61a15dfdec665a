"""Tools around the product: what it is made of, its generated pages, its checks and its tests."""
