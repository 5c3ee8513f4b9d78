"""How touch and sight of touch agree: the constants of g_t (paper, "Adding tactile feedback")."""

from ..types import TouchConstants

DEFAULT = TouchConstants(a1=1.0, b1=1.0 / (2.0 * 12.0**2), a2=1.0, b2=1.0 / (2.0 * 0.05**2))
"""Without touches to learn from: hand and effector agree within 12 px, events within 0.05 s (gone beyond 0.1 s)."""
