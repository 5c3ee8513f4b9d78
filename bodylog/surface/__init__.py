"""A body and a log judged by the robot's own surface, without a marker."""
