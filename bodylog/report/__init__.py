"""Report: records as figures, as a page, and as what a viewer shows."""
