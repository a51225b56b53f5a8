"""One cycle: describing functions, collocation, envelope prediction, identifiability."""
