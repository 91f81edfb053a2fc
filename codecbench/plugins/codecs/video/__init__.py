"""Video codecs through PyAV and FFmpeg: H.264, HEVC, AV1 and VP9, with Motion JPEG and FFV1 as controls.

PyAV's wheels carry FFmpeg with GPL builds of x264 and x265; only `library` imports it.
"""
