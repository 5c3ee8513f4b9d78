"""Locks on open files and folders, for as long as a
process lives; none where the system has no `flock`.
"""

try:
    import fcntl
except ImportError:
    # Windows: nothing is locked, and so nothing that another process may hold is removed
    fcntl = None  # type: ignore[assignment]


def lock_handle(handle: int, wait: bool) -> bool:
    """Whether the file or folder of an open handle is now
    locked; False where it cannot be, or another holds it.
    """
    if fcntl is None:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
