"""What the log's senses measured, in the body's own terms: records, gathering, touch, and the timeline of instants."""
