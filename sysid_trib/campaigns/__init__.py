"""Many records by one task: on the cores of a machine or of a cluster, into one store."""
