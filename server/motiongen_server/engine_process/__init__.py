"""Engine processes: what crosses between them and the gateway, and both ends of the way."""
