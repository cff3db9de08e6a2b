"""Networks, written so that they export as they read."""
