"""Who is in the detections of several views: people in space, followed over time, and the one that is solved."""
