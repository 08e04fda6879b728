"""What motion is: skeletons, rotations, motion, features and their scales, constraints."""
