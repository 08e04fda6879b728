"""A test suite for the motiongen protocol: `motiongen-compliance HOST:PORT` runs it against any server."""
