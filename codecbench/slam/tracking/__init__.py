"""Tracking: the pose of each frame, relocalization of lost frames, and the keyframe policy."""
