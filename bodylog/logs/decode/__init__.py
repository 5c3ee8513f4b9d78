"""Decode payloads to arrays: definitions, layouts, columns, message objects."""
