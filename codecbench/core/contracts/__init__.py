"""The interfaces that plugin authors implement. Empty on purpose: import the module that you need."""
