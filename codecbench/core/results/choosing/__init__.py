"""Which settings are good enough over a link."""
