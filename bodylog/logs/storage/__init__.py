"""Bytes of logs: memory-mapped files, remote files, decompression."""
