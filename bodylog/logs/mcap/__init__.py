"""MCAP files: read records, chunks and summary; check them, scan past damage, write."""
