"""Whether cameras are late against the joints, and what is said of it."""
