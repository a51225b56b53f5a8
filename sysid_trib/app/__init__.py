"""A local page in the browser for people without a terminal; it uses only the public names of the package."""
