"""The motiongen contract: code generated from the protos. See `motiongen.v1`."""
