"""The live filter: the batch filter's steps, run as readings arrive."""
