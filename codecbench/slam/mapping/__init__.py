"""Growing the map around a new keyframe, and closing loops."""
