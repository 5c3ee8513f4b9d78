"""Stage: perception."""
