"""Engine of the search: a record as rows along its path, their likelihood, and the fit of a model to them."""
