"""A log as a robot's signals: roles, clocks, joints, skin, tracks, frames."""
