"""Tables and a picture of landmark networks that ``train landmarks`` left."""
