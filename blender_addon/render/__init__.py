"""Render pictures of a baked take with Workbench: a preview video and a contact sheet. No GPU is needed."""
