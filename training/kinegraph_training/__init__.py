"""Training of kinegraph's models: PyTorch and Lightning on the runtime's own features and graphs."""
