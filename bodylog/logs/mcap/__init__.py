"""MCAP files: records, chunks, summary; read, checked, scanned past damage, written."""
