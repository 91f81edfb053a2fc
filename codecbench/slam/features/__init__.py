"""ORB features: corners, orientations, descriptors, and matches between them."""
