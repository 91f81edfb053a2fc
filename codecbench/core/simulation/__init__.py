"""Simulation of sender, link and receiver: which frames of a coded sequence arrive, and when."""
