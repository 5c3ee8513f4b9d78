"""Kinematics: predicted image points from a URDF, a camera and their unknown parameters θ."""
