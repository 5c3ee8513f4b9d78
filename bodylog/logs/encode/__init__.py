"""Encode arrays as payloads."""
