"""Arrays to payloads."""
