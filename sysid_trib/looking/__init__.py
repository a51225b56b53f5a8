"""What is in a file, before any fit."""
