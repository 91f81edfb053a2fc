"""The pytest side: benchmarks of codecs, their baseline, and the conformance checks as a test class."""
