"""How much evidence a hypothesis must win before it is chosen, the same for all."""

NATS = 20.0
"""Nats by which a hypothesis must explain a log better than the simpler one. Beyond chance there is what a model leaves
out: on 100 healthy drawn logs the hypothesis that a camera moved won 8 nats at most."""
