"""The compliance suite: does a server keep the protocol? `motiongen-compliance HOST:PORT` asks any."""
