"""Files a clip can be saved as, by suffix."""
