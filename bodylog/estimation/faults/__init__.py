"""The ways a sensor fails, one file each: found, named, and taken out of what is heard."""
