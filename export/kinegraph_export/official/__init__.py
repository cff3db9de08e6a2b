"""Networks of the released GraphMotion and MLD, under the names of their checkpoints."""
