"""Detectors of sensor faults, one file per kind:
they name a fault and remove or correct its readings.
"""
