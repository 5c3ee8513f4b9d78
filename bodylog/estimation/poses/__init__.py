"""Still poses without motion between them: each one is estimated separately."""
