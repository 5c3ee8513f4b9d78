"""Convert, cut, examine and repair any log; the result is a new MCAP."""
