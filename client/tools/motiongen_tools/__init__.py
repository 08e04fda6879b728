"""The command `motiongen`: characters and clips to files, a viewer, a load generator, and more."""
