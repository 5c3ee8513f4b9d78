"""Gaussian processes: model, marginal likelihood, inducing points, fitting."""
