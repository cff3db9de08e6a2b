"""The networks, written plainly so that they export as they read."""
