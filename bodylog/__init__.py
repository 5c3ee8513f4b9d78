"""bodylog: where a robot's body was, how sure that is,
and which sensor lied, from its log or beside the robot.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import __version__ as __version__

if TYPE_CHECKING:
    from .body.storage import load_body
    from .config import load_settings
    from .errors import BodylogError
    from .estimation.live import Belief
    from .online import Estimator
    from .pipeline import Result, convert, estimate, evaluate, extract, fit, ingest, observe, record
    from .settings import Settings

__all__ = [
    "Belief",
    "BodylogError",
    "Estimator",
    "Result",
    "Settings",
    "__version__",
    "convert",
    "estimate",
    "evaluate",
    "extract",
    "fit",
    "ingest",
    "load_body",
    "load_settings",
    "observe",
    "record",
]

_HOMES = {
    "Belief": ("estimation.live", "Belief"),
    "BodylogError": ("errors", "BodylogError"),
    "Estimator": ("online", "Estimator"),
    "Settings": ("settings", "Settings"),
    "load_body": ("body.storage", "load_body"),
    "load_settings": ("config", "load_settings"),
}
"""Where what is public stands, if not in the pipeline."""


def __getattr__(name: str) -> Any:
    """What is public, imported when first asked for: `import bodylog` imports nothing heavy."""
    if name not in __all__:
        raise AttributeError(
            f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}"
        )
    module, attribute = _HOMES.get(name, ("pipeline", name))
    return getattr(import_module(f"{__name__}.{module}"), attribute)
