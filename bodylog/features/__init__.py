"""Which features to look for in a log, and those found in it."""
