"""Processes in which other people's plugins are imported, so that the program itself never imports them."""
