"""bodylog: where a robot's body was, how sure that is, and which sensor lied, from its log or beside the robot."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .body.model import load as load_body
    from .estimation.streaming import Belief
    from .live import Estimator

__version__ = "0.1.0"
__all__ = ["Belief", "Estimator", "__version__", "load_body"]

_HOMES = {
    "Belief": ("bodylog.estimation.streaming", "Belief"),
    "Estimator": ("bodylog.live", "Estimator"),
    "load_body": ("bodylog.body.model", "load"),
}


def __getattr__(name: str) -> Any:
    """What is public, imported when first asked for: `import bodylog` itself imports nothing heavy."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    module, attribute = _HOMES[name]
    return getattr(import_module(module), attribute)
