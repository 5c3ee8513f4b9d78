"""The evidence that a hypothesis must win before it is chosen, one number for all."""

NATS = 20.0
"""Nats by which a hypothesis must explain a log better than the simpler one. The margin covers model errors: on 100
healthy drawn logs the hypothesis of a moved camera won at most 8 nats."""
