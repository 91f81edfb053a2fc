"""ORB features sent in the place of pictures."""
