"""Training data: joint angles at the times of images, selection, subsampling."""
