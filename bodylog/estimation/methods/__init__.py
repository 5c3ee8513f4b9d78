"""Estimation methods, one file per `--method`, and shared parts."""
