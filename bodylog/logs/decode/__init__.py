"""Payloads to arrays: definitions, layouts, columns, message objects."""
