"""What a force is: formula, library, TOML in and out."""
