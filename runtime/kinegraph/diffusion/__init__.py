"""The maths of sampling: pure functions on numpy arrays."""
