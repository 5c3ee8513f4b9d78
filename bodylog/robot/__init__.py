"""The robot of a log: its URDF, its camera, its calibration and its limits."""
