"""States: the motion fitted to the record, by least squares or by the innovations of one filter."""
