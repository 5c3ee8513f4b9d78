"""Files that are whole or absent, where outputs may go, what a file's numbers may be, and logs behind URLs."""
