"""Where frames become packets and packets become pictures: the only room that calls a codec for its result."""
