"""A log as a robot's signals: topic roles, clocks, joints, skin, tracks, frames.

For use outside: `recording.read` and `info`, `tidy.ingest`, `tables.export`, `lerobot_writer.write`,
`robot_description.described`.
"""
