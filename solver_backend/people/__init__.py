"""Whom the detections of several views show: people in space, followed over time, and the one that is solved."""
