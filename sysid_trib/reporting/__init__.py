"""A saved result as one page that needs nothing else: text, tables, figures."""
