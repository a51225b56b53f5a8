"""How likely a model with two noises makes a record, and at which parameters it is likeliest."""
