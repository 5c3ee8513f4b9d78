"""bodylog: where a robot's body was, how sure that is, and which sensor lied, from its log."""

__version__ = "0.1.0"
