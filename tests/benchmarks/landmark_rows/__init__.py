"""Tables and a picture of landmark networks that ``train model landmarks`` left."""
