"""The HTML page: sections, traces, data, script."""
