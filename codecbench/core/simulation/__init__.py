"""Sender, link and receiver in simulated time: what arrives of a coded sequence, and when."""
