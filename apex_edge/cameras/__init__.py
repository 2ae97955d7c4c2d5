"""Frame sources: the twin, recordings, live cameras."""
