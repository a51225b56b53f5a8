"""Search for the missing effect that explains the difference between model and record."""
