"""The filter beside a robot: the batch filter's steps, fed as readings come."""
