"""The evidence that a hypothesis must win before it is chosen, one number for all."""

NATS = 12.0
"""Nats by which a hypothesis must explain a log better than the simpler one. The margin covers model errors: on 3,600
sound drawn logs a camera's delay won at most 9.9 nats, on 100 a moved camera at most 8. With 20, a delay of 20 ms is
found in 9 instead of 16 of 20 reaches, and a camera moved by 2 px in 0 instead of 8."""
