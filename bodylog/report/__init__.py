"""Report: records as figures, as an HTML page, and as files for viewers."""
