"""Studies of noises and runs over many seeds."""
