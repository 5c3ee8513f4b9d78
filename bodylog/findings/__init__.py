"""What bodylog says of one log: faults, changes, misfits, the verdict and its figures."""
