"""The embedded sequence: a furnished room with real photographs, rendered with its exact camera path."""
