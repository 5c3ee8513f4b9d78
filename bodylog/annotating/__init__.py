"""Write features and estimates into a log, and read them back.

For use outside: `annotate.open_annotation`; `read_back.read_estimate`,
`read_features`, `read_metadata`; `messages.from_*`.
"""
