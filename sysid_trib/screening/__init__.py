"""What candidates would gain beside a model, each as one more column of its rows, and whether by chance."""
