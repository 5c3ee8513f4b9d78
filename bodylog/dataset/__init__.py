"""Whether a dataset is fit to learn from: each episode examined once, then judged beside its
siblings."""
