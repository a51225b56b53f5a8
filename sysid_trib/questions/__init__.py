"""Questions about a result: its uncertainty, the best next run, differences of samples, a forced response."""
