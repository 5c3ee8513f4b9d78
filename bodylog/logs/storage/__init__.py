"""Bytes: mapped files, remote files, compression."""
