"""The representation of motion: skeletons, rotations, motion, features and their statistics, constraints."""
