"""How noisy each sense is and how the joints move: learned from the log, the body's, or the paper's."""
