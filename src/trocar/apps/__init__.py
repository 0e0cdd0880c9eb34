"""What it is for: each folder a leaf that knows none of its siblings."""
