"""The first map from two frames, its growth around each new keyframe, and closing loops."""
