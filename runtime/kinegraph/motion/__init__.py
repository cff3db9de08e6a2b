"""Maths of motion: arrays of joints, features and rotations in, arrays out. Knows no clips, files or models."""
