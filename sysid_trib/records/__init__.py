"""Files of every kind become angle(time); several runs."""
