"""Lab files that are drawn anew: what is read of them, and how many as they should be."""
