"""Model to motion: equations, stick and slip, the two engines, the embedded example."""
