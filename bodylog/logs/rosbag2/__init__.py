"""rosbag2 folders and their SQLite files."""
