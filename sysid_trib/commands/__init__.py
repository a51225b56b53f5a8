"""The commands of the command line, one per file; each imports the modules it needs when it runs."""
