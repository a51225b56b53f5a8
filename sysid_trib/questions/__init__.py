"""Questions to a result: how sure it is, the best next run, the difference of samples, a forced response."""
