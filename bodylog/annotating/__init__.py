"""Write features and estimates into a log, and read them back.

For use outside: `annotate.annotate_log`, `annotating` and `write`; `read_back.read_estimate`,
`read_features`, `read_metadata`; `messages.from_*`.
"""
