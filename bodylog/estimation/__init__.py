"""Stage: estimation."""
