"""ORB features sent instead of frames."""
