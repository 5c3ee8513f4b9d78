"""What each sense measured: records, gathering from features, a file per sense, the timeline."""
