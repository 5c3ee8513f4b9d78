"""Tables of poses (CSV, Parquet, YAML) as logs."""
