"""Stage: body."""
