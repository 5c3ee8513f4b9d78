"""The evidence that a hypothesis must win before it is
chosen, and sizes of faults, one number each for all.
"""

EVIDENCE_THRESHOLD_NATS = 12.0
"""Nats by which a hypothesis must explain a log better than the simpler one. The margin covers
model errors: on 5,000 sound drawn logs a camera's delay won at most 10.5 nats, on 100 a moved
camera at most 8. With 20, a delay of 20 ms is found in 9 instead of 16 of 20 reaches, and a camera
moved by 2 px in 0 instead of 8."""
CERTAIN_SIGMA = 4.0
"""Standard deviations from zero of what is certainly not zero. With
4.9, where an offset wins EVIDENCE_THRESHOLD_NATS, an encoder that
drifts by 0.005 rad/s is named 3.75 s after its drift began, not 3.21 s."""
SIGNIFICANT_SIGMA = 3.0
"""Standard deviations from zero of what may be more than chance, which brings it once in 370 times:
a delay, the difference of two, a joint's play, the score of an error that lasts."""
MIN_DELAY_S = 1e-3
"""s: a camera's smaller delay is ignored; most cameras expose for longer."""
PRIOR_STD_RAD = 0.3
"""rad: prior standard deviation of a faulty encoder's offset."""
