"""ROS 1 bags (format 2.0): records, chunks; read, and scanned past damage."""
