"""The marker syntax of JPEG files (ITU-T T.81 annex B), which every JPEG codec here reads and checks."""
