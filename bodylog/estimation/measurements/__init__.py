"""What each sense measured: records, gathering from features, one file per sense, and the timeline."""
