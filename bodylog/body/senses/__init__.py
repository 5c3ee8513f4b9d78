"""What a body model knows of each sense: tracks, touch, encoders."""
