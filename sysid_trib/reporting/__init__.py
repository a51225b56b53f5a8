"""A saved result as one self-contained page: text, tables, figures."""
