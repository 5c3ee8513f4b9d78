"""One factor problem over a whole log: joints, lasting
encoder errors, and global parameters as columns.
"""
