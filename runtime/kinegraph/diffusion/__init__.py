"""The maths of sampling: pure functions on numpy arrays, float32 states under a float64 schedule."""
