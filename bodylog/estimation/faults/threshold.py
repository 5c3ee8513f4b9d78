"""How much evidence a hypothesis must win before it is chosen, the same for all."""

NATS = 20.0
"""Nats by which a hypothesis must explain a log better than the simpler one. What is not modelled in full (joints that
stick, pixels that err alike) made healthy encoders look faulty by up to 12 nats in 208 drawn and 22 recorded logs."""
