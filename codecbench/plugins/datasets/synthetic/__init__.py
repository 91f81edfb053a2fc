"""The built-in dataset `synthetic`: rendered scenes with exact camera paths."""
