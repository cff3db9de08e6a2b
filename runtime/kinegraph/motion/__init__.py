"""Motion as joints: skeleton, features, rotations and the `Clip` a caller receives."""
