"""The pose of each frame from the map, its place when it is lost, and which frames become keyframes."""
