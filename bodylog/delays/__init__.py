"""Whether cameras are late against the joints, and the findings about it."""
