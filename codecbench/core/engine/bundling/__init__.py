"""A run in one file, to be kept, cited and opened by strangers."""
