"""Stage: sim/scenarios."""
