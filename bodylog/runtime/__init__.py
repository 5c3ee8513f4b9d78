"""The process itself: signals, memory, threads, worker processes."""
