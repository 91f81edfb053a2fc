"""The pose of each frame: from two views at the start, from the map after that, from nothing when lost."""
