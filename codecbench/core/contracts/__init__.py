"""What a plugin author writes against. Empty on purpose: import the module that you need."""
