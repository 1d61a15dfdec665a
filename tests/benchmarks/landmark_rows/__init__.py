"""Tables and a picture of landmark networks trained by ``train model landmarks``."""
