"""The version of this package, as it stands in what it writes."""

__version__ = "0.1.0"
