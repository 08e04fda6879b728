"""`motiongen gallery`: a page of what a model makes of its presets and of targets; it opens from the disk."""
