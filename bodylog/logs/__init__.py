"""Stage: logs."""
