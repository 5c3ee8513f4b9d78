"""ROS 1 bags (format 2.0): read records and chunks, scan past damage."""
