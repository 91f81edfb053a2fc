"""A benchmark of codecs by what they do to the task that reads the pictures."""
