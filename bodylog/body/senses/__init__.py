"""Forward models of single senses: tracks, touch, encoders."""
