"""From a caption to tokens and to a semantic graph."""
