"""Tables of numbers from files of many kinds."""
