"""One cycle: describing functions, steady cycles, envelope prediction, identifiability."""
