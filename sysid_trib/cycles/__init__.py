"""What forces do over a cycle, and what they remember along a motion."""
