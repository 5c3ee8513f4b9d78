"""A log as a robot's signals: topic roles, clocks, joints, skin, tracks, frames.

For use outside: `recording.read_recording` and `info`, `tidy.write_tidy_log`,
`tables.export_signals`, `lerobot_writer.write_lerobot`, `robot_description.read_robot_description`.
"""
